"""Make the table of packages in ``docs/dependencies.md`` from the lock and from what the packages say of themselves.

``.venv/bin/python scripts/dependencies.py`` writes it anew; run it after ``requirements.lock`` has changed.
"""

import re
from importlib.metadata import distribution, requires
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "dependencies.md"
BEGIN, END = "<!-- packages: begin -->\n", "<!-- packages: end -->\n"
_LONGEST = 40

#: Reasons for the packages that are named in requirements.in.
WHY = {
    "uv": "installs the rest",
    "empy": "templates of the message generators",
    "cmake": "builds messages",
    "ninja": "builds messages",
    "setuptools": "links the Python packages",
    "cython": "compiles the steps of a tick",
    "colcon-ros": "builds the workspace",
    "colcon-bash": "makes `setup.bash`",
    "colcon-package-selection": "builds some packages alone",
    "colcon-parallel-executor": "builds packages at the same time",
    "colcon-package-information": "finds packages",
    "colcon-output": "tells of the build",
    "colcon-defaults": "settings of the build",
    "numpy": "arrays",
    "scipy": "least squares, rotations, interpolation",
    "pybullet": "simulated physics and images",
    "pin": "dynamics of the arms (pinocchio)",
    "cryptography": "keystores of SROS 2",
    "ompl": "search of free paths",
    "ruckig": "trajectories with limited jerk",
    "opencv-python-headless": "images, lens models",
    "pupil-apriltags": "AprilTags that OpenCV does not know",
    "rosbags": "bags, read and written",
    "mcap": "bags in MCAP files",
    "zstandard": "compressed bags",
    "pydantic": "checks of all data that enter",
    "pyyaml": "YAML",
    "xacro": "robots that are written as macros",
    "matplotlib": "plots of calibrations",
    "aiohttp": "the page of the nets",
    "posix-ipc": "semaphores of the link to the testbed",
    "foxglove-sdk": "the machine seen with Foxglove",
    "z3-solver": "proofs about nets",
    "pytest": "tests",
    "pytest-rerunfailures": "tests: a second browser for one that hung",
    "pytest-timeout": "tests: those that hang fail",
    "pytest-xdist": "tests",
    "hypothesis": "tests of properties",
    "jsonschema": "tests: the schema of net files",
    "networkx": "tests: graphs to compare with",
    "mcap-ros2-support": "tests: another reader of bags",
    "mkdocs-material": "docs as a site",
    "playwright": "tests: the page in a browser",
    "ruff": "style",
    "mypy": "types",
    "types-pyyaml": "types of pyyaml",
}

#: What packages do not say of themselves, or not briefly: from the texts of licences that they bring.
LICENCE = {
    "apsw": "OSI-approved, any",
    "cmeel-qhull": "Qhull",
    "cycler": "BSD-3-Clause",
    "empy": "LGPL-2.1-or-later",
    "kiwisolver": "BSD-3-Clause",
    "matplotlib": "Matplotlib (PSF-like)",
    "numpy": "BSD-3-Clause and others",
    "pytest-repeat": "MPL-2.0",
    "scipy": "BSD-3-Clause",
    "setuptools": "MIT",
}
MAKER = {
    "aiosignal": "aiohttp team",
    "frozenlist": "aiohttp team",
    "opencv-python-headless": "OpenCV Team",
    "mcap": "Foxglove",
    "mcap-ros2-support": "Foxglove",
    "types-pyyaml": "typeshed",
    "uv": "Astral Software Inc.",
}
#: Repackage C++ libraries for PyPI.
CMAKE_WHEEL = "cmake-wheel (G. Saurel, LAAS-CNRS)"


def locked() -> list[str]:
    """Names of the packages in the lock."""
    return re.findall(r"^([a-z0-9._-]+)==", (ROOT / "requirements.lock").read_text(encoding="utf-8"), re.MULTILINE)


def users() -> dict[str, list[str]]:
    """Packages of the lock that need a package, by its name."""
    found: dict[str, list[str]] = {}
    for user in locked():
        for needed in map(Requirement, requires(user) or []):
            if needed.marker is None or needed.marker.evaluate({"extra": ""}):
                found.setdefault(canonicalize_name(needed.name), []).append(user)
    return found


def row(name: str, used_by: list[str]) -> str:
    """The row of a package.

    Args:
        name: Its name in the lock.
        used_by: Packages that need it.
    """
    why = WHY.get(name) or f"of {', '.join(each for each in used_by[:3])}"
    return f"| {name} | {_maker(name)} | {_licence(name)} | {why} |"


def _maker(name: str) -> str:
    told = distribution(name).metadata
    if name in MAKER:
        return MAKER[name]
    if name.startswith("cmeel") or "cmake-wheel" in (told.get("Home-page") or ""):
        return CMAKE_WHEEL
    text = told.get("Author") or told.get("Author-email") or told.get("Maintainer-email") or ""
    first = re.split(r"[,;]|<| and ", text.replace('"', ""))[0].strip()
    return first if first == text else f"{first} and others" if "," in text else first


def _licence(name: str) -> str:
    if name in LICENCE:
        return LICENCE[name]
    told = distribution(name).metadata
    kinds = [each.rpartition(":: ")[2] for each in told.get_all("Classifier") or [] if each.startswith("License ::")]
    for text in (told.get("License-Expression"), told.get("License"), " or ".join(kinds)):
        if text and len(text) <= _LONGEST and "\n" not in text:
            return str(text)
    return " or ".join(kinds)


def table() -> str:
    """The whole table, without the wheels of ROS."""
    needed = users()
    rows = [row(name, needed.get(name, [])) for name in locked() if not name.startswith("ros-")]
    return "\n".join(["| package | made by | licence | here for |", "|---|---|---|---|", *rows, ""])


def wheels() -> str:
    """The wheels of ROS by name."""
    return ", ".join(f"`{name}`" for name in locked() if name.startswith("ros-"))


def page(text: str) -> str:
    """The page with table and wheels made anew."""
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    return f"{before}{BEGIN}{table()}\n**Wheels of ROS**: {wheels()}.\n{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
