"""Set-up says what a computer lacks and how far it is, builds what is needed and no more, and reuses what was built."""

import importlib.util
import os
import pty
import re
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from support.computer import ROOT, Computer


@pytest.fixture
def computer(tmp_path):
    return Computer(tmp_path)


def test_a_missing_compiler_is_named(computer):
    done = computer.run("setup")
    assert (done.returncode, done.stderr.startswith("setup: gcc is missing;")) == (4, True), done.stderr


def test_a_missing_python_is_named(computer):
    computer.add_compilers()
    done = computer.run("setup")
    assert done.returncode == 4
    assert (
        "setup: Python 3.11 is missing (no python3.11 on the PATH); install it, or set IM_PYTHON to one" in done.stderr
    )
    computer.write("python3", "exit 1")
    assert "does not run" in computer.run("setup").stderr
    done = computer.run("setup", IM_PYTHON="/no/python")
    assert (done.returncode, "IM_PYTHON=/no/python cannot be used" in done.stderr) == (4, True)


def test_the_environment_is_not_made_of_the_one_that_it_replaces(computer):
    """Whoever works in it has its Python first on the PATH."""
    computer.add_compilers()
    computer.add_python("python3.11")
    made = computer.root / ".venv" / "bin"
    assert computer.run("setup").returncode == 0
    shutil.copy(made / "python", made / "python3.11")
    (computer.root / "requirements.lock").write_text("another==1\n")
    done = computer.run("setup", PATH=f"{made}:{computer.bin}")
    assert done.returncode == 0, done.stderr
    assert [call.split()[0] for call in computer.calls if "-m venv" in call] == [str(computer.bin / "python3.11")] * 2
    (computer.root / "requirements.lock").write_text("yet_another==1\n")
    done = computer.run("setup", IM_PYTHON=str(made / "python"))
    assert (done.returncode, "is of the environment that is made anew" in done.stderr) == (4, True), done.stderr
    assert made.exists()


@pytest.mark.parametrize("name", ["two words", "käfig", "a,b", "a;b"])
def test_a_path_in_which_nothing_can_be_built_is_refused_before_anything_is_installed(tmp_path, name):
    (tmp_path / name).mkdir()
    computer = Computer(tmp_path / name)
    computer.add_compilers()
    done = computer.run("setup", LC_ALL="C.UTF-8")
    assert done.returncode == 4
    sentence = f"setup: messages of ROS cannot be built in the folder {computer.root}: its path may have letters"
    assert done.stderr.startswith(sentence), done.stderr
    assert not (computer.root / ".venv").exists()


def test_a_full_disk_is_named(computer, python):
    computer.add_compilers()
    computer.write("df", "echo head; echo 'disk 9000 8000 1000 90% /'")
    done = computer.run("setup", IM_PYTHON=python)
    assert (done.returncode, "only 1000 MB are free on the disk" in done.stderr) == (4, True), done.stderr
    assert not (computer.root / ".venv").exists()


def test_a_failed_step_shows_its_output_and_is_not_taken_as_done(computer):
    computer.add_compilers()
    computer.add_python("python3.11", 'case "$*" in "-m pip "*) echo "no network" >&2; exit 1 ;; esac')
    done = computer.run("setup")
    assert done.returncode == 1
    assert "no network\n" in done.stderr
    assert "setup: making .venv ..." in done.stdout
    assert "setup: step 'installing uv==" in done.stderr
    assert "running scripts/setup.sh again goes on from here" in done.stderr
    assert not (computer.root / ".venv" / ".im-installed").exists()


def test_a_failed_compile_shows_what_the_compiler_said(computer):
    """Ninja tells it on standard output; who was ended for the sake of another package has nothing to say."""
    computer.add_compilers()
    printed = {
        "a_msgs": ("-- fine", 0),
        "im_msgs": ("ld: cannot find -lnothing", 1),
        "tf2_msgs": ("-- ended", "'SIGINT'"),
    }
    build = "".join(
        f"""
    mkdir -p log/latest_build/{name} && echo "{line}" >log/latest_build/{name}/stdout_stderr.log
    echo "[1.5] ({name}) JobEnded: {{'identifier': '{name}', 'rc': {code}}}" >>log/latest_build/events.log"""
        for name, (line, code) in printed.items()
    )
    computer.add_python("python3.11", f'case "$*" in *-GNinja*) {build}\n exit 1 ;; esac')
    done = computer.run("setup")
    assert done.returncode == 1
    assert done.stderr.startswith("ld: cannot find -lnothing\nsetup: step 'building 4 packages"), done.stderr


def test_a_second_run_does_nothing(computer):
    computer.add_compilers()
    computer.add_python("python3.11")
    assert computer.run("setup").returncode == 0
    calls = len(computer.calls)
    done = computer.run("setup")
    assert (done.returncode, done.stdout.count("\n"), len(computer.calls)) == (0, 1, calls), done.stdout


def test_bytecode_is_made_once_even_for_whoever_wants_programs_to_write_none(computer):
    computer.add_compilers()
    computer.add_python("python3.11", 'echo "${PYTHONDONTWRITEBYTECODE-unset}: $*" >>"${0%/*}/bytecode"')
    assert computer.run("setup", PYTHONDONTWRITEBYTECODE="1").returncode == 0
    calls = (computer.root / ".venv" / "bin" / "bytecode").read_text().splitlines()
    packages = f"{computer.root}/ros_ws/src/im_bringup/"
    assert [call for call in calls if call.startswith("unset: ")] == [f"unset: - {packages}"]


@pytest.mark.parametrize(
    ("it_has", "built"),
    [
        (["tf2_msgs", "control_msgs", "controller_manager_msgs"], []),
        (["tf2_msgs"], ["control_msgs", "controller_manager_msgs"]),
    ],
)
def test_on_a_sourced_ros_only_what_it_lacks_is_built_and_as_it_builds_it(computer, it_has, built):
    computer.add_compilers()
    computer.add_python("python3")
    ros = computer.root.parent / "jazzy"
    (ros / "share" / "rclpy").mkdir(parents=True)
    index = ros / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    for name in it_has:
        (index / name).touch()
    done = computer.run("setup", ROS_DISTRO="jazzy", AMENT_PREFIX_PATH=str(ros))
    assert done.returncode == 0, done.stderr
    assert "--system-site-packages" in computer.called("-m venv")
    packages = computer.called("-GNinja").partition("--base-paths ")[2].partition(" --cmake-args")[0].split()
    assert [Path(package).name for package in packages] == ["im_msgs", *built]
    assert not [call for call in computer.calls if "underlay.py" in call]  # which leaves the C++ kinds out
    assert not [call for call in computer.calls if "fetch" in call or "store" in call]
    lock = (computer.root / ".venv" / ".im-lock").read_text()
    assert "ros-" not in lock
    assert "pydantic" in lock


def test_from_a_folder_of_wheels_nothing_comes_from_the_network(computer):
    computer.add_compilers()
    computer.add_python("python3.11")
    folder = computer.root.parent / "wheels"
    folder.mkdir()
    (folder / "uv-0-py3-none-any.whl").touch()
    done = computer.run("setup", "--wheels", str(folder))
    assert done.returncode == 0, done.stderr
    assert f"setup: packages come from {folder}, none from the network\n" in done.stdout
    assert f"--no-index --find-links {folder} --require-hashes --requirement" in computer.called("-m pip install")
    assert f"--offline --no-index --find-links {folder} " in computer.called("uv pip install")


def start(computer, output):
    argv = [computer.bin / "bash", computer.root / "scripts" / "setup.sh"]
    environment = {"PATH": str(computer.bin), "HOME": str(computer.root)}
    return subprocess.Popen(
        argv, env=environment, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
    )


@pytest.fixture
def gate(tmp_path):
    """A pipe: a program that reads from it waits until the test writes into it."""
    path = tmp_path / "gate"
    os.mkfifo(path)
    end = os.open(path, os.O_RDWR)  # so that neither side waits for the other to open it
    yield path
    os.close(end)


def test_a_long_step_tells_how_long_it_takes_line_by_line(computer, gate, tmp_path, wait_until):
    computer.add_compilers()
    computer.add_python("python3.11", f'case "$*" in "-m venv "*) read go <{gate} ;; esac')
    output = tmp_path / "output"
    with output.open("wb") as file:
        process = start(computer, file)
    ticks = re.compile(r"^setup: making \.venv \.\.\. +\d+ s$", re.M)
    wait_until(lambda: len(ticks.findall(output.read_text())) >= 2 or process.poll() is not None, "two lines")
    gate.write_text("go\n")
    assert process.wait(60.0) == 0, output.read_text()
    said = output.read_text()
    assert "\r" not in said
    assert re.search(r"^setup: making \.venv \.\.\. +\d+\.\d s$", said, re.M)


def test_on_a_terminal_a_long_step_moves_in_its_line(computer, gate, wait_until):
    computer.add_compilers()
    computer.add_python("python3.11", f'case "$*" in "pip install "*) read go <{gate} ;; esac')
    master, slave = pty.openpty()
    process = start(computer, slave)
    os.close(slave)
    said = bytearray()

    def read():
        try:
            while part := os.read(master, 4096):
                said.extend(part)
        except OSError:  # the other end is closed
            pass

    reader = threading.Thread(target=read)
    reader.start()
    tick = re.compile(rb"\r\x1b\[Ksetup: installing \d+ locked packages \.\.\. +\d+ s, \d+ of \d+(?=\r)")
    wait_until(lambda: len(tick.findall(said)) >= 2 or process.poll() is not None, "two times")
    gate.write_text("go\n")
    assert process.wait(60.0) == 0, said
    reader.join()
    os.close(master)
    assert tick.search(said)
    assert all(len(part) <= 82 for part in re.split(rb"[\r\n]+", bytes(said)))
    assert len(re.findall(rb"\n", said)) == said.count(b"\r\n") < 12


def test_ctrl_c_in_a_long_step_leaves_no_process(computer, gate, wait_until):
    computer.add_compilers()
    computer.add_python("python3.11", f'case "$*" in "-m venv "*) read go <{gate} ;; esac')
    process = start(computer, subprocess.PIPE)
    wait_until(lambda: (computer.root / "calls").exists() and "-m venv" in computer.calls[-1], "the step")
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    said, _ = process.communicate(timeout=60.0)  # to the end of its output: nobody else has it open
    assert process.returncode == 130
    assert b"setup: interrupted; run it again, it goes on where it stopped\n" in said


def script_module(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "scripts" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("IM_CACHE", str(tmp_path / "cache"))
    return script_module("message_cache")


@pytest.fixture
def clone(tmp_path):
    """``clone(name)``: a folder with the sources of a package ``a_msgs``, and the package as built there."""

    def make(name, built=True):
        root = tmp_path / name
        shutil.copytree(ROOT / "scripts", root / "scripts", ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(ROOT / "requirements.lock", root)
        source = root / "ros_ws" / "src" / "a_msgs" / "msg"
        source.mkdir(parents=True)
        (source / "A.msg").write_text("int8 a\n")
        if built:
            package = root / "ros_ws" / "install" / "a_msgs"
            python = package / "lib" / "python3.11" / "site-packages" / "a_msgs"
            python.mkdir(parents=True)
            (python / "__init__.py").write_text("A = 1\n")
            (package / "package.sh").write_text(f"prefix={package} venv={root}/.venv other={root}-other/ros_ws\n")
            (package / "lib" / "liba.so").write_bytes(b"\x7fELF\0\1\2")
        return root

    return make


def key(cache, root):
    return cache.key(root, [root / "ros_ws" / "src" / "a_msgs"])


def test_a_second_clone_gets_the_packages_with_its_own_paths(cache, clone, tmp_path):
    first, second = clone("first"), clone("second", built=False)
    entry = key(cache, first)
    assert entry == key(cache, second)
    assert cache.fetch(second, entry, ["a_msgs"]) is None
    stored = cache.store(first, entry, ["a_msgs"])
    assert stored == tmp_path / "cache" / "messages" / entry
    assert cache.fetch(second, entry, ["a_msgs"]) == stored
    package = second / "ros_ws" / "install" / "a_msgs"
    assert (package / "lib" / "liba.so").read_bytes() == b"\x7fELF\0\1\2"
    assert (package / "package.sh").read_text() == (
        f"prefix={package} venv={second}/.venv other={first}-other/ros_ws\n"
    )
    assert list(package.rglob("*.pyc"))
    assert sorted(path.name for path in (second / "ros_ws" / "install").iterdir()) == ["a_msgs"]


def test_whatever_goes_into_a_build_changes_the_key(cache, clone, monkeypatch):
    root = clone("one")
    message, lock, script = root / "ros_ws/src/a_msgs/msg/A.msg", root / "requirements.lock", root / "scripts/setup.sh"
    keys = [key(cache, root)]
    for path in (message, lock, script):
        path.write_text(path.read_text() + "# more\n")
        keys.append(key(cache, root))
    message.rename(message.with_name("B.msg"))
    keys.append(key(cache, root))
    message.with_name("B.msg").rename(message)
    assert key(cache, root) == keys[-2]
    for name in ("CFLAGS", "CXXFLAGS", "LDFLAGS", "CC", "CXX"):
        with monkeypatch.context() as patch:
            patch.setenv(name, "other")
            keys.append(key(cache, root))
    for name, function in (("machine", lambda: "pdp11"), ("libc_ver", lambda: ("glibc", "1.0"))):
        with monkeypatch.context() as patch:
            patch.setattr(cache.platform, name, function)
            keys.append(key(cache, root))
    monkeypatch.setattr(cache.sys, "version", "4.0")
    keys.append(key(cache, root))
    assert len(set(keys)) == len(keys)


@pytest.mark.parametrize("damage", [lambda data: data[:-7], lambda data: data[:500] + b"x" + data[501:], lambda _: b""])
def test_a_damaged_entry_is_noticed_and_removed(cache, clone, damage):
    first, second = clone("first"), clone("second", built=False)
    entry = key(cache, first)
    stored = cache.store(first, entry, ["a_msgs"])
    stored.write_bytes(damage(stored.read_bytes()))
    argv = [sys.executable, ROOT / "scripts" / "message_cache.py", "fetch", second, entry, "a_msgs"]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"fetch: {stored} was damaged and is removed\n"
    assert not stored.exists()
    assert not (second / "ros_ws" / "install" / "a_msgs").exists()
    assert cache.store(first, entry, ["a_msgs"]) == stored
    assert cache.fetch(second, entry, ["a_msgs"]) == stored


def test_what_works_in_one_clone_only_is_not_kept(cache, clone):
    root = clone("one")
    (root / "ros_ws/install/a_msgs/lib/liba.so").write_bytes(b"\0" + os.fsencode(root) + b"/ros_ws/build\0")
    with pytest.raises(cache.NotRelocatableError, match=r"liba\.so has .*/one/ros_ws in it"):
        cache.store(root, "0", ["a_msgs"])
    assert not cache.folder().exists()


def test_what_cannot_be_kept_leaves_nothing_in_the_cache(cache, clone):
    root = clone("one")
    (cache.folder() / "0").mkdir(parents=True)  # in its place
    with pytest.raises(OSError, match="directory"):
        cache.store(root, "0", ["a_msgs"])
    assert [path.name for path in cache.folder().iterdir()] == ["0"]


def test_two_set_ups_at_once_never_see_half_an_entry(cache, clone):
    first, second = clone("first"), clone("second", built=False)
    cache.store(first, "0", ["a_msgs"])
    stores = [threading.Thread(target=cache.store, args=(first, "0", ["a_msgs"])) for _ in range(8)]
    for thread in stores:
        thread.start()
    while any(thread.is_alive() for thread in stores):
        assert cache.fetch(second, "0", ["a_msgs"])
    assert [path.name for path in cache.folder().iterdir()] == ["0"]


def test_the_cache_keeps_what_was_used_last(cache, clone):
    root = clone("one")
    for number in range(cache.KEPT):
        path = cache.store(root, f"{number}", ["a_msgs"])
        os.utime(path, (number, number))
    cache.fetch(root, "0", ["a_msgs"])
    cache.store(root, "ff", ["a_msgs"])
    kept = sorted(path.name for path in cache.folder().iterdir())
    assert kept == sorted(["0", "ff", *(f"{number}" for number in range(2, cache.KEPT))])


FROM_WHEELS = (ROOT / ".venv" / "local_setup.bash").exists()


@pytest.mark.skipif(not FROM_WHEELS, reason="ROS is not from wheels here: every kind of message code is built")
def test_with_ros_from_wheels_the_kinds_that_rclpy_uses_are_built_and_no_more():
    libraries = ROOT / "ros_ws" / "install" / "im_msgs" / "lib"
    assert sorted(path.name for path in libraries.glob("lib*.so")) == [
        "libim_msgs__rosidl_generator_c.so",
        "libim_msgs__rosidl_generator_py.so",
        "libim_msgs__rosidl_typesupport_c.so",
        "libim_msgs__rosidl_typesupport_fastrtps_c.so",
        "libim_msgs__rosidl_typesupport_introspection_c.so",
    ]


GENERATE = """
import sys
import em
from rosidl_pycommon import generate_files
from rosidl_parser import parser
if sys.argv[1] == "quick":
    import im_rosidl
    parser.parse_idl_string = im_rosidl.parsed_once(parser.parse_idl_string)
    im_rosidl.read_templates_once(em)
for _ in range(2):
    generate_files(sys.argv[2], {"idl__functions.c.em": "%s.c", "idl__struct.h.em": "%s.h"})
"""


@pytest.mark.skipif(not FROM_WHEELS, reason="the generators are as ROS has them")
def test_the_quick_generators_generate_the_same_bytes(tmp_path):
    import json

    import ament_index_python
    import rosidl_parser
    import rosidl_pycommon

    modules = tmp_path / "modules"
    underlay = script_module("underlay")
    for package in (rosidl_parser, rosidl_pycommon):  # as installed, before they were made quick
        shutil.copytree(Path(package.__file__).parent, modules / package.__name__)
    for name, lines in underlay.QUICK.items():
        path = modules / name
        assert lines in path.read_text()
        path.write_text(path.read_text().replace(lines, ""))
    shutil.copy(ROOT / "scripts" / "im_rosidl.py", modules)
    share = Path(ament_index_python.get_package_share_directory("std_srvs")).parent
    files = ["geometry_msgs:msg/PoseWithCovariance", "std_srvs:srv/SetBool", "rcl_interfaces:msg/ParameterDescriptor"]
    made = {}
    for kind in ("quick", "plain"):
        output = tmp_path / kind
        arguments = {
            "package_name": "some_msgs",
            "output_dir": str(output),
            "template_dir": str(share / "rosidl_generator_c" / "resource"),
            "target_dependencies": [],
            "idl_tuples": [f"{share / name.partition(':')[0]}:{name.partition(':')[2]}.idl" for name in files],
        }
        (tmp_path / "arguments.json").write_text(json.dumps({**arguments, "target_dependencies": [__file__]}))
        environment = {
            **os.environ,
            "PYTHONPATH": f"{modules}:{os.environ.get('PYTHONPATH', '')}",
            "PYTHONHASHSEED": "0",
            "IM_IDL_TREES": str(tmp_path / "trees"),
        }
        argv = [sys.executable, "-c", GENERATE, kind, tmp_path / "arguments.json"]
        subprocess.run(argv, env=environment, check=True)
        made[kind] = {str(path.relative_to(output)): path.read_bytes() for path in output.rglob("*.[ch]")}
    assert len(made["plain"]) == 6
    assert made["quick"] == made["plain"]
    assert len(list((tmp_path / "trees").iterdir())) == len(files)
