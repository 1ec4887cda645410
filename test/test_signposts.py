"""References from docstrings to modules lead somewhere."""

import re
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[1] / "ros_ws" / "src"
REFERENCE = re.compile(r":mod:`([\w.]+)`")


def target(package, name):
    """Where a reference leads, from a package or from the packages of the workspace."""
    if name.startswith("."):
        return package / name[1:].replace(".", "/")
    return SOURCES / name.partition(".")[0] / name.replace(".", "/")


def test_each_module_that_a_docstring_names_is_there():
    lost = []
    for path in sorted(SOURCES.glob("*/im*/**/*.py")):
        for name in REFERENCE.findall(path.read_text(encoding="utf-8")):
            place = target(path.parent, name)
            ours = name.startswith((".", "im"))
            if ours and not place.is_dir() and not place.with_suffix(".py").exists():
                lost.append(f"{path.relative_to(SOURCES)}: {name}")
    assert not lost, lost
