"""The machine in the foreground, as machine.launch.py has it, in the environment of a sourced workspace."""

import os
import signal
import subprocess
from pathlib import Path

import pytest

from im_bringup.machine import leftovers
from im_bringup.machine import machine_state as machine
from im_bringup.tasks.agent import defaults, environment
from im_bringup.tasks.deployment import default_path, load
from im_bringup.tasks.middleware import RANGE
from im_core.executables import path_of
from support.whole_machine import free_port, segments

ROOT = Path(__file__).resolve().parent.parent
GIVEN_BY_SCRIPTS = (*defaults(), "ROS_LOG_DIR", "FASTRTPS_DEFAULT_PROFILES_FILE", "RMW_FASTRTPS_USE_QOS_FROM_XML")


def test_the_machine_gives_its_processes_what_the_scripts_give_to_tools(tmp_path):
    """A machine behaves alike, and repeats a mission alike, whoever starts it."""
    bare = {"HOME": str(tmp_path), "PATH": os.environ["PATH"], "IM_RUN_DIR": str(tmp_path)}
    script = ["bash", "-c", "source scripts/lib.sh; im_defaults; env"]
    said = subprocess.run(script, cwd=ROOT, env=bare, capture_output=True, text=True, check=True)
    told = dict(line.split("=", 1) for line in said.stdout.splitlines())
    given = environment({}, tmp_path, load(default_path()).with_values(clock_factor=0.0))
    for name in GIVEN_BY_SCRIPTS:
        paths = [Path(value).resolve() if "/" in value else value for value in (given[name], told[name])]
        assert paths[0] == paths[1], name
    assert environment({"OMP_NUM_THREADS": "4"}, tmp_path, load(default_path()))["OMP_NUM_THREADS"] == "4"


@pytest.fixture
def foreground(process, tmp_path, monkeypatch, small_deployment, wait_until):
    """A machine of two tasks that is ready, in the foreground of a process without what the scripts set."""
    for name in GIVEN_BY_SCRIPTS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(RANGE, "LOCALHOST")  # for which the rmw adds shared memory
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path / "results"))
    options = ("--foreground", "--factor=0", f"--port={free_port()}")
    started = process(path_of("im_bringup", "start"), small_deployment, *options)
    wait_until(lambda: "start: ready after" in started.out.read_text() or started.poll() is not None, "a start", 120.0)
    assert started.poll() is None, started.out.read_text()
    return started


def gone():
    record = machine.read()
    return record is None or not record.alive


@pytest.mark.end_to_end
def test_ctrl_c_stops_the_machine(foreground, wait_until):
    assert not gone()
    assert [process.pid for process in leftovers.processes() if segments(process.pid)] == []
    foreground.send_signal(signal.SIGINT)
    wait_until(lambda: foreground.poll() is not None, "the end", 60.0)
    assert (foreground.returncode, gone()) == (0, True)
    assert "stop: all tasks ended in order" in foreground.out.read_text()


@pytest.mark.end_to_end
def test_it_returns_when_the_machine_is_stopped_by_another(foreground, wait_until):
    subprocess.run([path_of("im_bringup", "stop")], check=True)
    wait_until(lambda: foreground.poll() is not None, "the end", 60.0)
    assert (foreground.returncode, gone()) == (0, True)
    assert "start: the machine was stopped" in foreground.out.read_text()


@pytest.mark.end_to_end
def test_a_killed_foreground_leaves_no_machine_behind(foreground, wait_until):
    foreground.kill()
    wait_until(gone, "the end of the machine", 60.0)
