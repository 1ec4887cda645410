"""The supervisor with bootstraps that are small programs: which death is followed by another life, and which is not."""

import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from im_bringup.machine import machine_state as machine
from im_bringup.machine import supervisor
from im_bringup.machine.bootstrap import SILENCE_S, SilentTasks
from im_bringup.tasks.registry import Progress
from im_core import clock
from im_core import patience as silence_module
from im_core.errors import StoreError
from im_core.processes.loop_heartbeat import Beat, Pulse
from im_core.processes.procfs import Scheduled

#: Writes the record of a machine, tells its life, and does what it is told for that life.
BOOTSTRAP = textwrap.dedent(
    """
    import os, signal, sys, time
    from pathlib import Path
    from im_bringup.machine import machine_state as machine
    from im_core.processes.loop_heartbeat import Beat, Pulse
    from im_core.processes.procfs import ProcessId

    lives, state, *deeds = Path(sys.argv[1]), *sys.argv[2:]
    signal.signal(signal.SIGINT, lambda *_: os._exit(0))
    me = ProcessId.current()
    with lives.open("a") as file:
        life = sum(1 for _ in lives.open())
        file.write(f"{me.pid}\\n")
    deed = deeds[life]
    state = machine.STARTING if "early" in deed else machine.FAILED if deed == "fail" else state
    machine.write(machine.MachineRecord(me.pid, me.start, state, "START", 1, "", "", 0.0, 1, 0, missing=["dom failed"]))
    if deed.startswith("die"):
        os.kill(me.pid, signal.SIGKILL)
    if deed.startswith("end"):
        sys.exit(7)
    if deed == "starve":
        print("terminate called after throwing an instance of 'std::bad_alloc'", flush=True)
        os.abort()
    if deed == "hang":
        Pulse.inherited().beat(Beat(3, 6.0, 5.0))
    time.sleep(600)
    """
)


@pytest.fixture
def supervise(tmp_path, monkeypatch):
    """``supervise(state, deed of each life...)``: the process of a supervisor, and a function that gives its lives.

    ``said`` is where its log goes.
    """
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1000 + os.getpid() % 100_000))  # of no machine
    program, lives, started = tmp_path / "bootstrap.py", tmp_path / "lives", []
    program.write_text(BOOTSTRAP)

    def start(*arguments, said=tmp_path / "said", options=()):
        supervisor = [sys.executable, "-m", "im_bringup.machine.supervisor", *options]
        argv = [*supervisor, sys.executable, program, lives, *arguments]
        started.append(subprocess.Popen([str(part) for part in argv], stdout=said.open("wb")))
        return started[-1], lambda: lives.read_text().split() if lives.exists() else []

    yield start
    for process in started:
        process.kill()
        process.wait()
    for pid in lives.read_text().split():
        subprocess.run(["kill", "-9", pid], check=False, capture_output=True)
    machine.remove()


def until(condition, seconds=60.0):
    deadline = clock.monotonic() + seconds
    while not (value := condition()):
        assert clock.monotonic() < deadline, "waited in vain"
        clock.sleep(0.02)
    return value


def test_a_bootstrap_that_is_killed_when_the_machine_was_ready_gets_another_life(supervise):
    process, lives = supervise(machine.READY, "die", "live")
    until(lambda: len(lives()) == 2)
    until(lambda: (record := machine.read()) is not None and record.pid == int(lives()[1]))
    process.send_signal(signal.SIGINT)  # is passed on
    assert process.wait(60.0) == 0
    assert len(lives()) == 2


def test_an_agent_that_is_killed_gets_another_life_whatever_the_state_of_the_machine(supervise, tmp_path):
    process, lives = supervise(machine.STARTING, "die", "hang", "end", "live", options=("--agent",))
    until(lambda: len(lives()) == 4)
    process.send_signal(signal.SIGINT)
    assert process.wait(60.0) == 0
    how = ("was killed by SIGKILL", "hung", "ended with exit code 7")
    said = (tmp_path / "said").read_text().splitlines()
    for sentence, word in zip(said, how, strict=True):
        assert sentence.startswith(f"[supervisor]: the agent {word}")
        assert sentence.endswith("; it is started again")


def test_an_agent_ends_with_its_supervisor(supervise):
    process, lives = supervise(machine.READY, "live", options=("--agent",))
    until(lambda: len(lives()) == 1 and machine.read())
    process.kill()
    until(lambda: not Path(f"/proc/{lives()[0]}").exists())


def test_a_full_disk_keeps_no_machine_from_being_started_again(supervise):
    _, lives = supervise(machine.READY, "die", "live", said=Path("/dev/full"))
    until(lambda: len(lives()) == 2)


@pytest.mark.parametrize(("state", "deed", "code"), [(machine.STARTING, "die", 1), (machine.READY, "end", 7)])
def test_what_never_was_ready_or_ended_by_itself_stays_dead(supervise, state, deed, code):
    process, lives = supervise(state, deed, "live")
    assert process.wait(60.0) == code
    assert len(lives()) == 1


def test_a_machine_that_was_ready_is_started_again_until_it_is_ready_again(supervise, tmp_path):
    process, lives = supervise(machine.READY, "die", "die early", "fail", "end early", "live")
    until(lambda: len(lives()) == 4)
    process.wait(60.0)  # the fourth was the third in vain
    assert (process.returncode, len(lives())) == (1, 4)
    said = (tmp_path / "said").read_text().splitlines()
    assert said == [
        "[supervisor]: the bootstrap was killed by SIGKILL; the machine is started again",
        "[supervisor]: the bootstrap was killed by SIGKILL; the machine is started again",
        "[supervisor]: the bootstrap failed to start its tasks: dom failed; the machine is started again",
        "[supervisor]: the bootstrap ended with exit code 7; the machine is given up",
    ]
    assert machine.read() is None


def test_a_machine_that_is_ready_again_has_all_its_tries_again(supervise):
    deeds = ("die", "die early", "die early", "die", "die early", "die early", "live")
    process, lives = supervise(machine.READY, *deeds)
    until(lambda: len(lives()) == len(deeds))
    until(lambda: (record := machine.read()) is not None and record.pid == int(lives()[-1]))
    process.send_signal(signal.SIGINT)
    assert process.wait(60.0) == 0


def test_a_machine_that_does_not_become_ready_again_in_time_is_started_once_more(supervise, monkeypatch, tmp_path):
    monkeypatch.setenv("IM_START_TIMEOUT_S", "3")
    process, lives = supervise(machine.READY, "die", "stay early", "live")
    until(lambda: len(lives()) == 3)
    assert "the bootstrap was not ready after 3 s; the machine is started again" in (tmp_path / "said").read_text()
    until(lambda: machine.read().state == machine.READY)
    process.send_signal(signal.SIGINT)
    assert process.wait(60.0) == 0


def test_what_the_system_refuses_is_tried_again_for_a_while(monkeypatch, capsys):
    monkeypatch.setattr(supervisor, "_AGAIN_S", 0.01)
    refusals = [OSError("no room"), OSError("no room"), StoreError("still none", file="f", reason="full")]

    def do():
        if refusals:
            raise refusals.pop(0)

    supervisor.BootstrapKeeper([])._insist(do)
    assert not refusals
    assert capsys.readouterr().out == "[supervisor]: no room\n[supervisor]: still none\n"


def test_a_bootstrap_whose_loop_stands_still_gets_another_life(supervise):
    process, lives = supervise(machine.READY, "hang", "live")
    until(lambda: len(lives()) == 2)
    with pytest.raises(ProcessLookupError):
        os.kill(int(lives()[0]), 0)
    process.send_signal(signal.SIGINT)
    assert process.wait(60.0) == 0


def test_a_bootstrap_that_is_stopped_counts_as_hung_and_one_that_tells_of_its_loop_does_not(monkeypatch):
    monkeypatch.setattr(supervisor, "SILENCE_S", 0.3)
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    try:
        pulse = Pulse.create()
        hang = supervisor.Hang(child.pid, pulse)
        for _ in range(50):  # it has not come to telling
            clock.sleep(0.02)
            assert hang.found() == ""
        for ticks in range(1, 50):
            pulse.beat(Beat(ticks, 0.0, 5.0))
            clock.sleep(0.02)
            assert hang.found() == ""
        os.kill(child.pid, signal.SIGSTOP)
        assert until(hang.found).startswith("nothing was heard of it for")
    finally:
        child.kill()
        child.wait()


NOBODY = 2**22 + 1
"""No process has that number."""


@pytest.fixture
def time(monkeypatch):
    """What monotonic clocks say, in a list of one."""
    now = [100.0]
    monkeypatch.setattr(clock, "monotonic", lambda: now[0])
    return now


def test_a_ready_task_that_falls_silent_is_told_once(time):
    silence = SilentTasks()
    silence.found(time[0])
    silence.heard("dom", NOBODY, Progress.READY)
    silence.heard("mcs", NOBODY + 1, Progress.CONFIGURED)  # its work may take long
    told = []
    while time[0] < 100.0 + SILENCE_S + 2.0:
        time[0] += 0.05
        told += silence.found(time[0])
    assert told == [("dom", NOBODY)]


def test_who_did_not_listen_blames_nobody(time):
    silence = SilentTasks()
    silence.heard("dom", NOBODY, Progress.READY)
    assert silence.found(time[0]) == []
    time[0] += 10.0 * SILENCE_S  # it was stopped meanwhile
    assert silence.found(time[0]) == []


def test_a_task_that_waits_for_a_processor_is_not_silent(time, monkeypatch):
    told = [Scheduled(0.0, 0.0)]
    monkeypatch.setattr(silence_module, "scheduled", lambda _: told[0])
    silence = SilentTasks()
    silence.heard("dom", NOBODY, Progress.READY)
    for _ in range(1000):
        time[0] += 0.5
        told[0] = Scheduled(told[0].ran_s + 0.01, told[0].queued_s + 0.49)
        assert silence.found(time[0]) == []


def test_a_bootstrap_that_is_refused_memory_is_named(supervise, monkeypatch, tmp_path):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    log = tmp_path / "log" / "bootstrap.log"
    log.parent.mkdir()
    _, lives = supervise(machine.READY, "starve", "live", said=log)
    until(lambda: len(lives()) == 2)
    words = "the bootstrap asked for more memory than its limit; the machine is started again"
    assert f"[supervisor]: {words}" in log.read_text()
