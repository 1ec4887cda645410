"""Who may know whom (docs/architecture.md): read from the import statements of all packages."""

import ast
import functools
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

SOURCES = Path(__file__).resolve().parent.parent / "ros_ws" / "src"
PACKAGES = sorted(path.name for path in SOURCES.iterdir() if (path / path.name / "__init__.py").is_file())
MESSAGES = {
    "action_msgs",
    "builtin_interfaces",
    "control_msgs",
    "controller_manager_msgs",
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
    "im_cell": {"im_core"},
    "im_bag": {"im_core"},
    "im_pnt": {"im_core"},
    "im_pnt_node": {"im_core", "im_bag", "im_pnt"},
    "im_pnt_analysis": {"im_core", "im_bag", "im_pnt"},
    "im_pnt_display": {"im_core", "im_bag", "im_pnt", "im_pnt_analysis"},
    "im_dom": {"im_core"},
    "im_dispatcher": {"im_core", "im_cell", "im_calibration", "im_pnt", "im_pnt_node", "im_pnt_analysis"},
    "im_coordinators": {"im_core", "im_cell", "im_calibration", "im_mcs", "im_pnt", "im_pnt_node", "im_pnt_analysis"},
    "im_mcs": {"im_core", "im_bag", "im_cell"},
    "im_calibration": {"im_core", "im_bag", "im_cell"},
    "im_vss": {"im_core", "im_bag", "im_cell", "im_calibration"},
    "im_sim": {"im_core", "im_cell"},
    "im_bringup": {"im_core", "im_cell", "im"},
    "im": {"im_core"},
}

#: Packages that are clients of the machine and nothing else, on top of rclpy and interfaces.
CLIENTS = {"im"}

#: Where each heavy library may be imported: package, or package/folder.
LIBRARIES = {
    "pybullet": ("im_sim",),
    "pybullet_data": ("im_sim",),
    "pinocchio": ("im_cell", "im_mcs", "im_sim"),
    "ruckig": ("im_mcs",),
    "coal": ("im_mcs",),
    "ompl": ("im_coordinators",),
    "mcap": ("im_bag",),
    "posix_ipc": ("im_core",),
    # im_sim/cameras: the lens warps and blurs every frame; nothing else is as fast, or gives the same pixels
    "cv2": ("im_calibration", "im_vss", "im_sim/cameras"),
}

#: Packages that install with pip, without the machine, and the distributions that hold what they import.
ALONE = ("im_core", "im_bag", "im_pnt", "im_pnt_analysis", "im_dom", "im_pnt_display", "im_pnt_node")
DISTRIBUTIONS = {"yaml": "pyyaml", "z3": "z3-solver", "pydantic_core": "pydantic", "lz4": "rosbags"}

HOST_END = "im_cell.link.HostEnd"


@functools.cache
def tree(path):
    """The syntax tree of a file; many tests look at it."""
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


@functools.cache
def imports(path):
    """Dotted names of what a file imports, with line numbers; ``from a import b`` gives ``a.b``."""
    found = []
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found += [(node.lineno, f"{node.module}.{alias.name}") for alias in node.names]
    return found


@functools.cache
def files(package):
    return sorted((SOURCES / package / package).rglob("*.py")) + sorted((SOURCES / package / package).rglob("*.pyi"))


@functools.cache
def relative(path):
    """``im_sim/cameras/render.py`` for the file of that name in the package im_vss."""
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
        shell = package in CLIENTS or path.startswith(f"{package}/ros/")
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
        ours = package not in CLIENTS and path != "im_core/clock.py"
        return ours and module.partition(".")[0] in ("time", "datetime")

    assert not offences(package, forbidden)


@pytest.mark.parametrize("package", PACKAGES)
def test_shells_of_other_packages_are_not_imported(package):
    def forbidden(_, module):
        top, _, rest = module.partition(".")
        foreign = top in PACKAGES and top not in (package, "im_core")
        return (
            foreign and rest.partition(".")[0] == "ros" and not (top == "im_pnt_node" and rest.startswith("ros.node"))
        )

    assert not offences(package, forbidden)


@pytest.mark.parametrize("package", PACKAGES)
def test_truth_is_for_who_simulates_and_who_judges(package):
    """What estimates and moves must not know what the simulated cell is really like."""
    may = ("im_cell/", "im_sim/", "im_bringup/calibration/truth.py", "im_bringup/ros/truth_error.py")

    def forbidden(path, module):
        return not path.startswith(may) and module.startswith(("im_cell.robot.truth", "im_cell.link.host", HOST_END))

    assert not offences(package, forbidden)


#: Who opens files beside the readers of im_core, and which; all others are files from elsewhere.
OPEN_FILES = {
    "im_core/files.py": "the reader",
    "im_core/text/jsontext.py": "the reader of JSON",
    "im_core/text/yamltext.py": "the reader of YAML",
    "im_bag/reading.py": "the reader of bags",
    "im_bag/storage.py": "a private copy of a file of a bag, for SQLite to take up its log",
    "im_bag/files.py": "record by record, of limited size; the delivery of a topic, out of its own file",
    "im_bag/writer.py": "what it writes itself",
    "im_bringup/ros/client_output.py": "standard output of the program",
    "im_pnt_node/journal/ended.py": "what it writes itself",
    "im_pnt_node/journal/strategies.py": "a folder, to lock what it writes itself",
    "im_bringup/tasks/upkeep.py": "logs of the machine's own processes",
    "im_core/processes/process.py": "logs and standard input of children",
    "im_core/processes/procfs.py": "/proc",
    "im_bringup/machine/members.py": "/proc",
    "im_bringup/machine/leftovers.py": "/proc",
    "im_mcs/control/law_server.py": "standard input, from its parent",
    "im_coordinators/path_search.py": "standard input, from its parent; the log of its own child",
    "im_core/file_lock.py": "a file that says which process holds it",
    "im_pnt_node/journal/folder.py": "the node's own journal, in a folder that it has locked",
    "im_sim/urdf_loader.py": "a file in memory, for pybullet",
    "im_dom/file.py": "the DOM's own data base",
    "im_dom/salvage.py": "the DOM's own data base, where it is damaged",
    "im_dom/transactions.py": "the DOM's own list of transactions",
}
OPENERS = {"open", "read_text", "read_bytes", "fdopen", "load", "safe_load", "full_load", "unsafe_load", "load_all"}
OPENERS |= {"safe_load_all", "loadtxt", "genfromtxt", "fromfile", "imread", "FileStorage", "connect", "Reader"}
MODULES_THAT_OPEN = {"os", "io", "yaml", "json", "np", "numpy", "cv2", "sqlite3", "pickle", "tomllib"}


def opens(path):
    """Calls in a file that open one or parse YAML: of a path, of a library, or the built-in."""
    for node in ast.walk(tree(path)):
        if not isinstance(node, ast.Call):
            continue
        match node.func:
            case ast.Name(id="open" | "Reader" as name):
                yield node.lineno, name
            case ast.Attribute(value=ast.Name(id=library), attr=name) if library in MODULES_THAT_OPEN:
                if name in OPENERS:
                    yield node.lineno, f"{library}.{name}"
            case ast.Attribute(value=value, attr="read_text" | "read_bytes" | "open" as name):
                if name != "open" or (node.args and isinstance(node.args[0], ast.Constant)):
                    yield node.lineno, f"{ast.unparse(value)}.{name}"


@pytest.mark.parametrize("package", PACKAGES)
def test_files_from_elsewhere_pass_the_readers(package):
    """Size, depth and kind of a file are checked in one place (docs/security.md), so that none can be forgotten."""
    found = {relative(path): [f"{line}: {call}" for line, call in opens(path)] for path in files(package)}
    readers = {"files.read_text", "files.read_bytes"}
    wrong = {
        path: told
        for path, calls in found.items()
        if path not in OPEN_FILES and (told := [call for call in calls if call.partition(": ")[2] not in readers])
    }
    assert not wrong


@pytest.mark.parametrize("package", PACKAGES)
def test_signals_that_ask_to_end_are_heeded_in_one_way(package):
    """A handler of its own would forget SIGHUP, or heed it under ``nohup``."""
    allowed = {
        "im_core/processes/end_signals.py",
        "im_core/rate_groups/budget.py",  # SIGALRM
        "im_bringup/machine/interrupts.py",
        "im_pnt_analysis/cli/terminal.py",
    }
    found = {relative(path) for path in files(package) if "signal.signal(" in path.read_text(encoding="utf-8")}
    assert found <= allowed


@pytest.mark.parametrize("package", PACKAGES)
def test_only_members_of_the_machine_and_children_are_signalled(package):
    """A number in a record may be a stranger's: ``signal_member`` looks, and a child's is its parent's to know."""
    allowed = {"im_bringup/machine/members.py": "pidfd_send_signal", "im_core/processes/process.py": "os.kill"}
    wrong = []
    for path in files(package):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            call = re.search(r"os\.kill\b|killpg|pidfd_send_signal|pthread_kill", line)
            if call and allowed.get(relative(path)) != call.group():
                wrong.append(f"{relative(path)}:{number}: {line.strip()}")
    assert not wrong


def modules():
    """The modules of all packages by dotted name."""
    found = {}
    for package in PACKAGES:
        for path in files(package):
            parts = path.relative_to(SOURCES / package).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@functools.cache
def knows():
    """Whom each module imports, among our modules; what stands under ``TYPE_CHECKING`` counts, too."""
    known = modules()

    def module_of(name):
        while name and name not in known:
            name = name.rpartition(".")[0]
        return name

    return {
        name: {found for _, imported in imports(path) if (found := module_of(imported)) and found != name}
        for name, path in known.items()
    }


def circles(graph):
    """Sets of nodes of a graph that reach each other (Tarjan)."""
    index, low, stack, found = {}, {}, [], []

    def visit(node):
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in graph[node]:
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            component = [stack.pop()]
            while component[-1] != node:
                component.append(stack.pop())
            if len(component) > 1:
                found.append(sorted(component))

    for node in graph:
        if node not in index:
            visit(node)
    return found


def test_no_modules_import_each_other_in_a_circle():
    assert not circles(knows())


def test_no_folders_import_each_other_in_a_circle():
    """A folder is a layer: what its modules import, its neighbours' modules do not import back."""

    def folder(module):
        parts = module.split(".")
        return ".".join(parts[: 2 if len(parts) > 2 else 1])

    graph = {}
    for module, others in knows().items():
        if folder(module).count("."):
            graph.setdefault(folder(module), set()).update(
                folder(other) for other in others if folder(other).count(".") and folder(other) != folder(module)
            )
    graph = {node: {other for other in others if other in graph} for node, others in graph.items()}
    assert not circles(graph)


def rooms(graph):
    """Find the imports of rooms of folders, such as ``im_pnt_node.ros.commands``; modules beside rooms stand alone."""
    room = {module: ".".join(module.split(".")[:3]) for module in graph}
    found = {}
    for module, others in graph.items():
        found.setdefault(room[module], set()).update(room[other] for other in others if room[other] != room[module])
    return found


def test_no_rooms_import_each_other_in_a_circle():
    """Likewise within a folder: rooms, and the modules that stand beside them."""
    assert not circles(rooms(knows()))


def test_a_circle_of_rooms_is_seen():
    graph = {"p.a.x.one": {"p.a.y.one"}, "p.a.y.one": set(), "p.a.y.two": {"p.a.x.two"}, "p.a.x.two": set()}
    assert not circles(graph)
    assert circles(rooms(graph)) == [["p.a.x", "p.a.y"]]


def test_one_class_name_means_one_thing():
    """A search for a name finds one thing; names that begin with an underscore are a module's own affair.

    A client names the same things as the machine.
    """
    found = {}
    for module, path in modules().items():
        if module.partition(".")[0] in CLIENTS:
            continue
        for node in tree(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found.setdefault(node.name, []).append(module)
    assert not {name: places for name, places in found.items() if len(places) > 1}


@pytest.mark.parametrize("package", ALONE)
def test_what_nets_need_is_what_pip_installs(package):
    """``pip install`` of these folders brings all they import, and nothing of the machine; ROS is sourced."""
    sourced = MESSAGES | {"rclpy", "ament_index_python", "service_msgs"}
    machine = {"posix_ipc", "foxglove"}  # shared memory with the servo; the bridge
    tops = {module.partition(".")[0] for path in files(package) for _, module in imports(path)}
    others = tops - set(sys.stdlib_module_names) - {package, "pytest"} - sourced - machine
    needed = {DISTRIBUTIONS.get(top, top) for top in others}
    told = re.search(r"install_requires=\[(.*?)\]", (SOURCES / package / "setup.py").read_text(), re.DOTALL)[1]
    assert set(re.findall(r'"([^"]+)"', told)) == needed | {"setuptools"}
    assert needed & set(PACKAGES) <= set(ALONE)


def test_one_build_holds_all_that_pip_installs(tmp_path):
    """``pip install ./nets``: each module and file of the packages, their commands, and nothing beside."""
    folder = SOURCES.parents[1] / "nets"
    built, about = tmp_path / "lib", tmp_path / "im_nets.egg-info"
    command = [sys.executable, "setup.py", "--quiet", "build", "--build-base", str(tmp_path), "egg_info", "--egg-base"]
    subprocess.run([*command, str(tmp_path)], cwd=folder, check=True, timeout=300, capture_output=True)

    def held(root: Path) -> set[str]:
        return {str(path.relative_to(root)) for path in root.rglob("*") if path.is_file() and path.suffix != ".pyc"}

    assert held(built) == {f"{package}/{name}" for package in ALONE for name in held(SOURCES / package / package)}
    needed = "".join((SOURCES / package / "setup.py").read_text() for package in ALONE)
    assert set((about / "requires.txt").read_text().split()) == (
        {
            name
            for told in re.findall(r"install_requires=\[(.*?)\]", needed, re.DOTALL)
            for name in re.findall(r'"(.+?)"', told)
        }
        - {*ALONE, "setuptools"}
    )
    assert sorted(re.findall(r"^\w+ = im_\S+", (about / "entry_points.txt").read_text(), re.MULTILINE)) == sorted(
        re.findall(r'"(\w+ = im_[^"]+)"', needed)
    )


@pytest.mark.parametrize(
    "words",
    ["verify {net}", "simulate {net} --steps 3", "time {net} --command pick", "draw {net} -o {out}", "test {tests}"],
    ids=lambda words: words.split()[0],
)
def test_nets_are_judged_where_neither_ros_nor_the_machine_is(words, tmp_path):
    ros = {"ament_index_python", "rclpy", "rosidl_runtime_py"}
    banned = {*LIBRARIES, *MESSAGES, *PACKAGES, *ros, "foxglove"} - {*ALONE, "mcap"}
    program = f"""
import sys
class Ban:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {sorted(banned)}:
            raise ModuleNotFoundError(f"there is no {{name}} here", name=name.partition(".")[0])
sys.meta_path.insert(0, Ban())
from im_pnt_analysis.cli import main
sys.exit(main(sys.argv[1:]))
"""
    docs = SOURCES.parents[1] / "docs" / "nets"
    given = {
        "net": docs / "pick_and_place.yaml",
        "out": tmp_path / "net.svg",
        "tests": docs / "tasks" / "confirm.yaml",
    }
    command = [sys.executable, "-c", program, *(word.format(**given) for word in words.split())]
    workspace = SOURCES.parent
    kept = [
        folder
        for folder in os.environ.get("PYTHONPATH", "").split(os.pathsep)
        if not Path(folder).is_relative_to(workspace) or not banned & set(Path(folder).relative_to(workspace).parts)
    ]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(kept)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300, env=env)
    assert (done.returncode, done.stderr) == (0, "")
