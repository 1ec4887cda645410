"""Who may know whom (docs/architecture.md): read from the import statements of all packages."""

import ast
from pathlib import Path

import pytest

SOURCES = Path(__file__).resolve().parent.parent / "ros_ws" / "src"
PACKAGES = sorted(path.name for path in SOURCES.iterdir() if (path / path.name / "__init__.py").is_file())
MESSAGES = {
    "action_msgs",
    "builtin_interfaces",
    "control_msgs",
    "diagnostic_msgs",
    "geometry_msgs",
    "im_msgs",
    "lifecycle_msgs",
    "rcl_interfaces",
    "rosgraph_msgs",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "tf2_msgs",
    "trajectory_msgs",
    "unique_identifier_msgs",
    "visualization_msgs",
}

#: Packages of ours that each package may import, besides itself.
MAY_IMPORT = {
    "im_core": set(),
    "im_pnt": {"im_core"},
    "im_mcs": {"im_core"},
    "im_vss": {"im_core"},
    "im_sim": {"im_core"},
    "im_dom": {"im_core"},
    "im_bringup": {"im_core"},
    "im_dispatcher": {"im_core", "im_pnt"},
    "im_coordinators": {"im_core", "im_pnt"},
}

#: Where each heavy library may be imported: package, or package/folder.
LIBRARIES = {
    "pybullet": ("im_sim", "im_vss/camera", "im_vss/bench"),
    "pybullet_data": ("im_sim", "im_vss/camera"),
    "pinocchio": ("im_mcs", "im_sim"),
    "ruckig": ("im_mcs", "im_coordinators"),
    "coal": ("im_mcs", "im_coordinators"),
    "cv2": ("im_vss",),
}


def imports(path):
    """Dotted names of what a file imports, with line numbers; ``from a import b`` gives ``a.b``."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), filename=str(path))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            for alias in node.names:
                yield node.lineno, f"{node.module}.{alias.name}"


def files(package):
    return sorted((SOURCES / package / package).rglob("*.py"))


def relative(path):
    """``im_vss/camera/render.py`` for the file of that name in the package im_vss."""
    return path.relative_to(SOURCES).as_posix().partition("/")[2]


def offences(package, forbidden):
    """``file:line: module`` for each import for which ``forbidden(file, module)`` is true."""
    return [
        f"{relative(path)}:{line}: {module}"
        for path in files(package)
        for line, module in imports(path)
        if forbidden(relative(path), module)
    ]


def test_all_packages_are_known():
    assert set(PACKAGES) == set(MAY_IMPORT)


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_import_only_what_they_may(package):
    allowed = MAY_IMPORT[package] | {package}
    assert not offences(package, lambda _, module: module.partition(".")[0] in set(PACKAGES) - allowed)


@pytest.mark.parametrize("package", PACKAGES)
def test_cores_know_no_ros(package):
    def forbidden(path, module):
        shell = path.startswith(f"{package}/ros/")
        top = module.partition(".")[0]
        return not shell and (top in MESSAGES or top == "rclpy" or ".ros." in f"{module}.")

    assert not offences(package, forbidden)


@pytest.mark.parametrize("package", PACKAGES)
def test_heavy_libraries_stay_where_they_belong(package):
    def forbidden(path, module):
        places = LIBRARIES.get(module.partition(".")[0])
        return places is not None and not path.startswith(tuple(f"{place}/" for place in places))

    assert not offences(package, forbidden)


@pytest.mark.parametrize("package", PACKAGES)
def test_only_im_core_clock_reads_the_wall_clock(package):
    def forbidden(path, module):
        return path != "im_core/clock.py" and module.partition(".")[0] in ("time", "datetime")

    assert not offences(package, forbidden)


@pytest.mark.parametrize("package", PACKAGES)
def test_shells_of_other_packages_are_not_imported(package):
    def forbidden(_, module):
        top, _, rest = module.partition(".")
        foreign = top in PACKAGES and top not in (package, "im_core")
        return foreign and rest.partition(".")[0] == "ros" and not (top == "im_pnt" and rest.startswith("ros.node"))

    assert not offences(package, forbidden)
