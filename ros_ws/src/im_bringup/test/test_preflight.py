"""What this host lacks is said in one sentence before anything starts."""

import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from collections import namedtuple
from pathlib import Path

import pytest

from im_bringup.machine import doctor, machine_state, preflight, start
from im_core import names
from im_core.errors import ImError

Usage = namedtuple("Usage", "total used free")


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path / "results"))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for variable in ("ROS_DISCOVERY_SERVER", "RMW_IMPLEMENTATION", "ROS_SECURITY_ENABLE"):
        monkeypatch.delenv(variable, raising=False)


def with_free(monkeypatch, **free):
    """``shutil.disk_usage`` of a host with so many bytes free on the file systems that are named."""

    def disk_usage(path):
        return Usage(2**40, 0, next((count for name, count in free.items() if name in Path(path).parts), 2**40))

    monkeypatch.setattr(shutil, "disk_usage", disk_usage)


def test_a_host_that_has_it_all(monkeypatch, tmp_path):
    with_free(monkeypatch)
    preflight.check_host()
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["results", "ros", "run"]


@pytest.mark.parametrize(("full", "remedy"), [("results", "make room"), ("shm", "scripts/stop.sh removes the files")])
def test_a_full_disk(monkeypatch, full, remedy):
    with_free(monkeypatch, **{full: 2**20})
    with pytest.raises(
        ImError, match=rf"{full} has 1 MiB free, and 16 MiB are needed; {remedy}.*; nothing was started$"
    ):
        preflight.check_host()


@pytest.mark.parametrize("full", ["run", "results", "ros", "shm"])
def test_a_file_system_that_takes_no_more_files(monkeypatch, full):
    told = namedtuple("Told", "f_files f_favail")
    with_free(monkeypatch)
    monkeypatch.setattr(os, "statvfs", lambda path: told(1000, 5 if full in path.parts else 500))
    with pytest.raises(ImError, match=rf"{full} takes 5 files more, and 128 are needed; .*; nothing was started$"):
        preflight.check_host()
    monkeypatch.setattr(os, "statvfs", lambda path: told(0, 0))  # btrfs has as many as it likes
    preflight.check_host()


@pytest.mark.parametrize("variable", ["IM_RUN_DIR", "IM_RESULTS_DIR", "ROS_LOG_DIR"])
def test_a_folder_that_cannot_be_made(monkeypatch, tmp_path, variable):
    (tmp_path / "file").touch()
    monkeypatch.setenv(variable, str(tmp_path / "file" / "folder"))
    words = rf"file/folder cannot be made: Not a directory; .* set {variable} to another folder; nothing was started$"
    with pytest.raises(ImError, match=words):
        preflight.check_host()


def test_no_folder_for_temporary_files(monkeypatch):
    def none():
        raise FileNotFoundError(2, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setattr(tempfile, "gettempdir", none)
    with pytest.raises(
        ImError, match=r"^no folder for temporary files is writable; set TMPDIR to another folder; nothing was started$"
    ):
        preflight.check_host()


@pytest.mark.parametrize("options", [("--port", "18199"), ("--host", "localhost")], ids=["machine", "agent"])
@pytest.mark.parametrize("folder", ["run", "results", "ros", "/dev/shm"])
def test_what_cannot_be_written_is_one_sentence_of_start_whatever_is_left_there(monkeypatch, tmp_path, folder, options):
    for name in ("run/log", "results", "ros"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "run").chmod(0o700)
    (tmp_path / "run" / "pnt_display.url").touch()
    read_only = tmp_path / folder
    shell = 'mount --bind "$1" "$1" && mount -o remount,ro,bind "$1" || exit 77; exec "$0" "${@:2}"'
    command = ["-m", "im_bringup.machine.start", "--timeout", "1", *options]
    domain = str(1000 + os.getpid() % 100_000)  # of no machine
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    machine_state.write(
        machine_state.MachineRecord(2**22 + 1, 0, machine_state.READY, "START", 1, "", "", 0.0, 1, 0)
    )  # of a dead one
    try:
        done = subprocess.run(
            ["unshare", "--map-root-user", "--mount", "bash", "-c", shell, sys.executable, str(read_only), *command],
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
    finally:
        machine_state.remove()
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip("this process may not mount a file system of its own")
    (said,) = done.stderr.splitlines()
    assert said.startswith(f"start: {read_only} cannot be written: Read-only file system; ")
    assert said.endswith("; nothing was started")
    assert (done.returncode, done.stdout) == (1, "")


@pytest.mark.parametrize(
    ("variable", "value", "sentence"),
    [
        (
            "ROS_DISCOVERY_SERVER",
            "10.0.0.1:11811",
            "ROS_DISCOVERY_SERVER is 10.0.0.1:11811: nodes ask only this server for each other; "
            "'unset ROS_DISCOVERY_SERVER' mends it",
        ),
        (
            "RMW_IMPLEMENTATION",
            "rmw_cyclonedds_cpp",
            "RMW_IMPLEMENTATION is rmw_cyclonedds_cpp, which is not installed (installed: rmw_fastrtps_cpp); "
            "'unset RMW_IMPLEMENTATION' mends it",
        ),
    ],
)
def test_an_environment_in_which_nobody_is_found(monkeypatch, tmp_path, capsys, variable, value, sentence):
    index = tmp_path / "share/ament_index/resource_index/rmw_typesupport"
    index.mkdir(parents=True)
    for name in ("rmw_implementation", "rmw_fastrtps_cpp"):
        (index / name).touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    with_free(monkeypatch)
    monkeypatch.setenv(variable, value)
    with pytest.raises(ImError, match=rf"^{re.escape(sentence)}; nothing was started$"):
        preflight.check_host()
    monkeypatch.setattr("sys.argv", ["doctor"])
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1000 + os.getpid() % 100_000))  # of no machine
    assert doctor.main() == 1
    told = capsys.readouterr().out.splitlines()
    assert [line.partition(": FAULT: ")[2] for line in told if ": FAULT: " in line] == [sentence]
    monkeypatch.setenv(variable, "rmw_fastrtps_cpp" if variable.startswith("RMW") else "")
    assert doctor.main() == 0
    assert all(line.endswith(": ok") for line in capsys.readouterr().out.splitlines())


def test_security_that_ros_does_not_have_or_has_no_keys_for(monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(tmp_path / "nowhere"))
    with_free(monkeypatch)
    with pytest.raises(
        ImError, match=r"^ROS_SECURITY_ENABLE is true, and no node can be made \(.+\); .*nothing was sta"
    ):
        preflight.check_host()
    monkeypatch.setattr(preflight, "_NODE_S", 0.001)
    with pytest.raises(ImError, match=r"no node can be made \(waited 0.001 s for one, in vain\); "):
        preflight.check_host()
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "false")
    preflight.check_host()


def test_a_loopback_interface_that_is_down():
    """As it is in a network of one's own."""
    done = subprocess.run(
        ["unshare", "--map-root-user", "--net", sys.executable, "-m", "im_bringup.machine.start", "--timeout", "1"],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    if "unshare" in done.stderr:
        pytest.skip("this process may not have a network of its own")
    assert (done.returncode, done.stdout) == (1, "")
    assert re.fullmatch(
        r"start: the loopback interface does not work \(.*\), over which nodes find each other; "
        r"'sudo ip link set lo up' mends it; nothing was started\n",
        done.stderr,
    )


@pytest.fixture
def limits(monkeypatch):
    """Limits of open files that are only played."""
    now = {}
    real = resource.getrlimit
    opened = resource.RLIMIT_NOFILE
    monkeypatch.setattr(resource, "getrlimit", lambda kind: now["limits"] if kind == opened else real(kind))
    monkeypatch.setattr(resource, "setrlimit", lambda _, limits: now.update(limits=limits))
    return now


def test_too_few_open_files(limits):
    limits["limits"] = (64, 64)
    with pytest.raises(
        ImError, match=r"may open 64 files here \(ulimit -n\), and up to 256 are needed; an administrator .*; nothing"
    ):
        preflight.check_host()


def test_a_limit_of_the_size_of_files(monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda _: (102_400, resource.RLIM_INFINITY))
    words = (
        r"^a file may have 0.098 MiB here \(ulimit -f\), and 32 MiB are needed; 'ulimit -f unlimited' lifts it; nothing"
    )
    with pytest.raises(ImError, match=words):
        preflight.check_host()


def test_a_soft_limit_of_open_files_is_raised(limits, monkeypatch):
    with_free(monkeypatch)
    limits["limits"] = (64, 4096)
    preflight.check_host()
    assert limits["limits"] == (256, 4096)
    limits["limits"] = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    preflight.check_host()
    assert limits["limits"][0] == resource.RLIM_INFINITY


def test_a_start_says_that_somebody_has_stopped_the_machine(monkeypatch, capsys):
    for left in ("end_all", "remove_shared_memory"):
        monkeypatch.setattr(start.leftovers, left, lambda: None)
    start.clear_the_way(fresh=False)
    assert "emergency stop" not in capsys.readouterr().out
    (names.run_dir() / names.ESTOP).write_text("request on /mcs/estop")
    start.clear_the_way(fresh=True)
    assert "arms get no power until scripts/im recover resets it" in capsys.readouterr().out


def test_what_is_in_the_way_of_a_start_is_named(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1000 + os.getpid() % 100_000))  # of no machine
    names.display_file().mkdir()
    with pytest.raises(ImError, match=r"pnt_display\.url cannot be removed: Is a directory$"):
        start.clear_the_way(fresh=True)


@pytest.mark.parametrize("where", ["| true", "> /dev/full", ">&-"], ids=["no reader", "full disk", "closed"])
def test_what_nobody_hears_ends_neither_a_start_nor_a_stop(where):
    code = "from im_core.output import *; say('one'); say('two'); complain('ended')"
    run = ["bash", "-c", f'set -o pipefail; "$0" -c "$1" {where}', sys.executable, code]
    done = subprocess.run(run, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "ended\n")


@pytest.mark.parametrize("text", ["abc", "-5", "nan", "inf"])
def test_a_time_to_start_in_that_is_none_is_refused(text, monkeypatch, capsys):
    monkeypatch.setenv("IM_START_TIMEOUT_S", text)
    with pytest.raises(SystemExit, match="2"):
        start.parser().parse_args([])
    assert f"{text} is no time between 0 and 86400 s" in capsys.readouterr().err
