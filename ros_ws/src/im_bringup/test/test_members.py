"""Only processes of the machine are signalled, whatever a record or the process table says."""

import os
import subprocess
from signal import SIGKILL

import pytest

from im_bringup.machine import leftovers, stop
from im_bringup.machine import machine_state as machine
from im_bringup.machine.machine_state import MachineRecord
from im_bringup.machine.members import is_member, signal_member
from im_bringup.tasks.agent import MARKER
from im_core.processes.procfs import ProcessId


@pytest.fixture
def instance(monkeypatch):
    """A ROS domain of the test's own; its record is removed."""
    domain = 30_000 + os.getpid()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    yield f"im{domain}"
    machine.remove()


@pytest.fixture
def started():
    """``started(mark, **options)``: a process that waits; it has begun, for until then it has no environment."""
    running = []

    def start(mark="", **options):
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        process = subprocess.Popen(["cat"], env={**os.environ, MARKER: mark}, **pipes, **options)
        running.append(process)
        process.stdin.write(b"\n")
        process.stdin.flush()
        assert process.stdout.readline() == b"\n"
        return process

    yield start
    for process in running:
        process.kill()
        process.communicate()


def record_of(process):
    return MachineRecord(process.pid, process.start, machine.READY, "START", 1, "/run", "d.yaml", 0.0, 1, 8080)


def test_a_member_is_signalled(instance, started):
    process = started(instance)
    assert is_member(ProcessId.of(process.pid))
    assert signal_member(ProcessId.of(process.pid), SIGKILL)
    assert process.wait(60.0) == -SIGKILL
    assert not signal_member(ProcessId.of(process.pid), SIGKILL)


@pytest.mark.parametrize("mark", ["", "{}0", "x{}"])
def test_a_stranger_in_a_record_is_left_alone(instance, started, mark):
    stranger = started(mark.format(instance))
    machine.write(record_of(ProcessId.of(stranger.pid)))
    said = []
    assert stop.stop(said.append) == 0
    assert f"the record names process {stranger.pid}, which is not of this machine and is left alone" in said[0]
    assert machine.read() is None
    assert leftovers.kill([ProcessId.of(stranger.pid)], timeout_s=0.0) == [ProcessId.of(stranger.pid)]
    assert stranger.poll() is None


def test_a_number_that_is_used_again_is_left_alone(instance, started):
    process = started(instance)
    known = ProcessId.of(process.pid)
    assert not signal_member(ProcessId(known.pid, known.start - 1), SIGKILL)
    assert process.poll() is None


def test_what_another_user_marked_is_left_alone(instance, started):
    if os.geteuid() != 0:
        pytest.skip("only root may start a process of another user")
    stranger = started(instance, user=65534)
    assert not signal_member(ProcessId.of(stranger.pid), SIGKILL)
    assert ProcessId.of(stranger.pid) not in leftovers.processes()
    assert stranger.poll() is None


@pytest.mark.parametrize("pid", [-1, 0, 1, "1", None, 2.5, True])
def test_a_record_names_a_process(instance, pid):
    machine.write(MachineRecord(pid, 1, machine.READY, "START", 1, "/run", "d.yaml", 0.0, 1, 8080))
    assert stop.stop(lambda _: None) == 0
    assert machine.read() is None
