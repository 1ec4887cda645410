"""The scripts teach, refuse what is wrong with one sentence, and say what a computer lacks."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from bench.chaos.demo import DemoTrial, carry_out
from support.computer import Computer
from support.whole_machine import free_port, write_few_poses

ROOT = Path(__file__).resolve().parent.parent
SEEDS = (5, 6, 12, 13, 39)
"""Of signals to the demo; each kind is among them, and moments of the start and of the command are."""
SCRIPTS = sorted(path.stem for path in (ROOT / "scripts").glob("*.sh") if path.stem != "lib")


def test_every_script_is_here():
    wanted = {"setup", "demo", "test", "start", "stop", "calibrate_camera", "shell", "run", "record", "replay"}
    wanted |= {"bench", "chaos"}
    assert wanted <= set(SCRIPTS)


@pytest.mark.parametrize("name", SCRIPTS)
def test_help_teaches(script, name):
    done = script(name, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    assert f"scripts/{name}.sh" in done.stdout
    assert "Exit code" in done.stdout
    assert "#" not in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 120


def im(*arguments):
    return subprocess.run(["bash", ROOT / "scripts" / "im", *arguments], capture_output=True, text=True, check=False)


def test_the_command_line_teaches_and_refuses_what_it_does_not_know():
    assert os.access(ROOT / "scripts" / "im", os.X_OK)
    for arguments in ((), ("--help",), ("-h",)):
        done = im(*arguments)
        assert (done.returncode, done.stderr) == (0, "")
        assert "scripts/im recover" in done.stdout
    done = im("recovr")
    assert (done.returncode, done.stderr) == (
        2,
        "im: there is no subcommand recovr; there are: action calibrate cell doctor dom lifecycle load node param pnt "
        "recover run security service strategies tasks topic unload view vss\n",
    )


def test_recover_helps_and_says_that_no_machine_runs():
    done = im("recover", "--help")
    assert (done.returncode, "Exit codes:" in done.stdout, "usage: im recover" in done.stdout) == (0, True, True)
    done = im("recover")
    domain = os.environ["ROS_DOMAIN_ID"]
    sentence = (
        f"recover: no machine runs in ROS domain {domain}: none was heard within 5 s; scripts/start.sh starts one"
    )
    assert (done.returncode, done.stderr.startswith(sentence)) == (3, True), done.stderr


@pytest.mark.parametrize(
    "line",
    [
        "im topic list",
        "bag_report.sh none",
        "calibrate_camera.sh",
        "record.sh",
        "replay.sh none",
        "run.sh im_mcs model",
        "start.sh none.yaml",
        "stop.sh",
    ],
)
def test_ctrl_c_ends_a_script_without_a_traceback_from_its_first_moment(line):
    run = ["env", "--block-signal=INT", "bash", "-c", f"kill -INT $$; exec scripts/{line}"]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_the_first_program_of_a_domain_leaves_its_folder_to_this_user_alone(tmp_path, monkeypatch):
    """ROS makes the folder of its logs, and those above it, open to others."""
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path / "run"))
    monkeypatch.delenv("ROS_LOG_DIR")
    done = im("topic", "list")
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "run" / "ros").is_dir()
    assert oct((tmp_path / "run").stat().st_mode & 0o777) == "0o700"


def test_a_node_helps_and_starts_with_nothing_it_does_not_know(script):
    done = script("run", "im_mcs", "mcs", "--help")
    assert (done.returncode, done.stderr) == (0, "")
    assert "Node ``/mcs``" in done.stdout
    done = script("run", "im_mcs", "mcs", "--hepl")
    assert (done.returncode, "unrecognized arguments: --hepl" in done.stderr) == (2, True)
    assert "model" in script("run", "im_mcs", "--help").stdout.split()


@pytest.mark.parametrize("name", SCRIPTS)
def test_scripts_are_executable_bash(name):
    path = ROOT / "scripts" / f"{name}.sh"
    assert os.access(path, os.X_OK)
    assert path.read_text().startswith("#!/usr/bin/env bash\n")
    assert subprocess.run(["bash", "-n", path], check=False).returncode == 0


@pytest.mark.parametrize(
    ("name", "arguments", "sentence"),
    [
        ("setup", ["--cleen"], "setup: unknown argument --cleen; --help tells what there is"),
        ("setup", ["--wheels"], "setup: --wheels needs a folder"),
        ("setup", ["--wheels", "none"], "setup: --wheels: there is no folder none"),
        ("setup", ["--wheels", "docs"], "setup: --wheels: there are no wheels (*.whl) in "),
        ("demo", ["--cameras"], "demo: unknown argument --cameras"),
        ("demo", ["--seed"], "demo: --seed needs a value"),
        ("demo", ["--poses", "none.yaml"], "demo: there is no poses file none.yaml"),
        ("demo", ["--mission", "dance"], "demo: there is no mission dance; there are calibration and handover"),
        ("start", ["none.yaml"], "none.yaml: cannot be read"),
        ("start", ["--factor", "-1"], "start: clock_factor: -1: Input should be greater than or equal to 0"),
        ("start", ["--calibration", "none"], "/none: no calibration: there is no such folder"),
        ("start", ["--calibration", "docs"], "/docs: no calibration: it holds no <camera>.yaml, extr"),
        ("start", ["--speed"], "unrecognized arguments: --speed"),
        ("stop", ["now"], "unrecognized arguments: now"),
        ("calibrate_camera", ["--cameras"], "--cameras: expected at least one argument"),
        (
            "calibrate_camera",
            ["--json", "--camera", "wall"],
            "there is no --camera; there are --cameras, --poses, --target, --accuracy",
        ),
        ("run", ["im_dm"], "run: there is no package with executables 'im_dm'; did you mean 'im_dom'?"),
        ("run", ["im_dom", "dm"], "run: there is no executable of im_dom 'dm'; did you mean 'dom'?"),
    ],
)
def test_bad_usage_is_refused_with_a_sentence(script, name, arguments, sentence):
    done = script(name, *arguments)
    assert (done.returncode, sentence in done.stderr) == (2, True), done.stderr


def test_without_a_machine_calibrate_camera_says_so(script):
    done = script("calibrate_camera")
    domain = os.environ["ROS_DOMAIN_ID"]
    sentence = f"im run: no machine runs in ROS domain {domain}: none was heard within 5 s; scripts/start.sh starts one"
    assert (done.returncode, done.stderr.startswith(sentence)) == (3, True), done.stderr


def test_an_option_that_pytest_does_not_have_is_refused_before_any_check(script):
    done = script("test", "--selct", "spot")
    assert done.returncode == 2
    assert "unrecognized arguments: --selct" in done.stderr
    assert "==" not in done.stdout


def test_run_lists_what_there_is(script):
    done = script("run")
    assert done.returncode == 0
    assert "im_bringup: action agent bootstrap data_objects " in done.stdout
    assert "im_dom: dom\n" in done.stdout
    assert script("run", "im_dom").stdout == "dom\n"


def test_shell_runs_a_command_with_everything_sourced(script):
    done = script(
        "shell", "python", "-c", "import rclpy, im_msgs.srv, tf2_msgs.msg, control_msgs.action; print('here')"
    )
    assert (done.returncode, done.stdout) == (0, "here\n"), done.stderr
    assert script("shell", "bash", "-c", "exit 7").returncode == 7


ARENAS = """
import ctypes, sys, threading
at_work, stay = threading.Barrier(9), threading.Event()
def work():
    block = bytes(100_000)
    at_work.wait()
    stay.wait()
for _ in range(8):
    threading.Thread(target=work, daemon=True).start()
at_work.wait()
libc = ctypes.CDLL(None)
libc.fopen.restype = ctypes.c_void_p
file = ctypes.c_void_p(libc.fopen(b"/dev/stdout", b"w"))
libc.malloc_info(0, file)
libc.fclose(file)
stay.set()
"""


def test_threads_share_the_arenas_of_malloc(script):
    """Each arena keeps the most that any thread ever needed in it."""

    def arenas(*command):
        return script("shell", *command).stdout.count("<heap nr=")

    assert arenas("env", "--unset=MALLOC_ARENA_MAX", "python", "-c", ARENAS) >= 8
    assert arenas("python", "-c", ARENAS) <= 2


def test_scripts_work_without_a_home(script):
    done = script("run", "im_dom", HOME="")
    assert (done.returncode, done.stdout) == (0, "dom\n"), done.stderr


BEFORE_SETUP = ["start", "stop", "run", "shell", "record", "replay", "bag_report", "calibrate_camera"]


@pytest.mark.parametrize("name", BEFORE_SETUP)
def test_before_setup_scripts_say_what_to_do(tmp_path, name):
    done = Computer(tmp_path).run(name)
    assert done.returncode == 3
    assert done.stderr == f"{name}: the workspace is not built yet; run scripts/setup.sh first\n"


@pytest.mark.parametrize("distribution", ["jazzy", "humble"])
def test_where_ros_is_sourced_wheels_are_taken_all_the_same(tmp_path, distribution):
    """Python would find the modules of that ROS first, which are for another Python."""
    computer = Computer(tmp_path)
    computer.add_compilers()
    computer.add_python("python3.11", f'echo "<$PYTHONPATH>" >>{tmp_path}/searched')
    ros = tmp_path / "ros"
    (ros / "share" / "rclpy").mkdir(parents=True)
    mine = tmp_path / "mine"
    sourced = {
        "IM_WHEELS": "1",
        "ROS_DISTRO": distribution,
        "AMENT_PREFIX_PATH": f"{mine}:{ros}",
        "LD_LIBRARY_PATH": f"{ros}/lib",
        "PYTHONPATH": f"{ros}/lib/python3.12/site-packages:{mine}",
    }
    assert computer.run("setup", **sourced).returncode == 0
    assert set((tmp_path / "searched").read_text().splitlines()) == {f"<{mine}>"}
    done = computer.run("shell", "env", **sourced)
    told = dict(line.split("=", 1) for line in done.stdout.splitlines() if "=" in line)
    assert [told[name] for name in ("AMENT_PREFIX_PATH", "LD_LIBRARY_PATH", "PYTHONPATH")] == [str(mine), "", str(mine)]


@pytest.mark.parametrize("transfer", [shutil.copytree, shutil.move])
def test_a_clone_that_was_copied_or_moved_is_set_up_anew_before_it_runs(tmp_path, transfer):
    """Its programs would be those of the other folder."""
    computer = Computer(tmp_path)
    computer.add_compilers()
    computer.add_python("python3.11")
    assert computer.run("setup").returncode == 0
    old, computer.root = computer.root, tmp_path / "other"
    transfer(old, computer.root)
    done = computer.run("shell", "basename", "a/b")
    assert (done.returncode, done.stdout) == (3, "")
    told = f"shell: {computer.root} was moved, or copied, since it was set up; run scripts/setup.sh first\n"
    assert done.stderr == told
    assert computer.run("setup").returncode == 0
    assert computer.run("shell", "basename", "a/b").stdout == "b\n"


def test_a_source_that_is_newer_than_what_was_built_of_it_is_named(tmp_path):
    computer = Computer(tmp_path)
    computer.add_compilers()
    computer.add_python("python3.11")
    source = computer.root / "ros_ws" / "src" / "Any.msg"
    source.touch()
    assert computer.run("setup").returncode == 0
    assert computer.run("shell", "basename", "a/b").stderr == ""
    built = computer.root / "ros_ws" / "install" / ".im-built"
    os.utime(built, (source.stat().st_mtime - 10.0,) * 2)
    done = computer.run("shell", "basename", "a/b")
    told = "ros_ws/src/Any.msg is newer than what was built of it; scripts/setup.sh builds it"
    assert (done.returncode, done.stdout, done.stderr) == (0, "b\n", f"shell: {told}\n")
    assert computer.run("setup").returncode == 0  # it is the same as before
    assert computer.run("shell", "basename", "a/b").stderr == ""


def test_a_clone_may_be_entered_by_a_link(tmp_path):
    computer = Computer(tmp_path)
    computer.add_compilers()
    computer.add_python("python3.11")
    assert computer.run("setup").returncode == 0
    (tmp_path / "link").symlink_to(computer.root)
    computer.root = tmp_path / "link"
    assert computer.run("shell", "basename", "a/b").stdout == "b\n"


SPEAKS = """
import sys
from pathlib import Path
from im_bringup.ros.client_output import own_output
try:
    with own_output():
        print("progress", flush=True)
        print("complaint", file=sys.stderr, flush=True)
        Path(sys.argv[1]).touch()
finally:
    Path(sys.argv[2]).touch()
"""


def test_a_client_whose_terminal_is_gone_comes_to_its_end(tmp_path):
    master, slave = os.openpty()
    os.close(master)
    ends = [tmp_path / "within", tmp_path / "behind"]
    with os.fdopen(slave, "wb") as gone:
        with pytest.raises(OSError, match="Input/output error"):
            os.write(slave, b"x")
        run = ["bash", ROOT / "scripts" / "shell.sh", "python", "-c", SPEAKS, *ends]
        subprocess.run(run, stdin=subprocess.DEVNULL, stdout=gone, stderr=gone, timeout=300, check=False)
    assert all(end.exists() for end in ends)


@pytest.mark.end_to_end
@pytest.mark.parametrize("seed", SEEDS, ids=lambda seed: str(DemoTrial.of(seed)))
def test_a_demo_that_is_cut_short_leaves_nothing(tmp_path, seed):
    """At a moment drawn from the seed; ``scripts/chaos.sh --demo`` does it more often."""
    end = carry_out(DemoTrial.of(seed), write_few_poses(tmp_path), free_port())
    assert not end.left, f"{end}\n{end.said}"
    assert "Traceback" not in end.said, end.said
