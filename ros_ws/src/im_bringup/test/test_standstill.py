"""What makes a hang: ticks of the process's own, or CPU time in which it did not tick; never time that has passed."""

import math
import os
import signal
import subprocess
import sys

import pytest

from im_bringup.tasks import standstill
from im_bringup.tasks.agent import Agent, Died, ProcessCommand
from im_bringup.tasks.standstill import Standstill
from im_core.processes import loop_heartbeat
from im_core.processes.loop_heartbeat import Beat, Pulse
from im_core.processes.loop_watch import TICK_S, LoopWatch, waits_of_threads
from im_core.processes.procfs import cpu_of


class Loop:
    """A loop that turns when it is nudged, or does not; and how long its threads wait for a processor."""

    def __init__(self):
        self.turns, self.hangs, self.wait_s = 0, False, 0.0
        self.pulse = Pulse.create()
        self.watch = LoopWatch(self.pulse, lambda: self.turns, self.nudge, lambda: 5.0, lambda: {"1": self.wait_s})

    def nudge(self):
        self.turns += not self.hangs

    def tick(self, times, starved=0.0):
        for _ in range(times):
            self.wait_s += starved * TICK_S
            self.watch.tick()
        return self.pulse.last()


@pytest.fixture
def loop():
    return Loop()


def test_a_loop_that_turns_stands_never_still_for_long(loop):
    assert loop.tick(100).standing_s <= TICK_S
    assert loop.pulse.last().ticks == 100


def test_a_loop_that_hangs_stands_still_by_its_own_ticks(loop):
    loop.tick(3)
    loop.hangs = True
    stands = [loop.tick(1).standing_s for _ in range(14)]
    assert stands[-1] >= 5.0
    assert Standstill(os.getpid(), loop.pulse).found(0.0) == f"its loop stood still for {stands[-1]:.1f} s"


@pytest.mark.parametrize("read", ["turns", "allowed_s"])
def test_what_stood_still_while_it_was_allowed_is_no_hang_after(read):
    """A start-up phase that ends in the middle of a look, after either of what is read."""
    state, looks = {"turns": 1, "allowed_s": 300.0}, iter(range(100))

    def of(name):
        told = state[name]
        if name == read and next(looks) == 40:
            state.update(turns=2, allowed_s=5.0)  # the loop itself has not come to turn
        return told

    pulse = Pulse.create()
    watch = LoopWatch(pulse, lambda: of("turns"), lambda: None, lambda: of("allowed_s"), dict)
    judge = Standstill(os.getpid(), pulse)
    for look in range(45):
        watch.tick()
        assert judge.found(float(look)) == ""


def test_waiting_for_a_processor_does_not_count(loop):
    loop.tick(3)
    loop.hangs = True
    assert loop.tick(100, starved=1.0).standing_s <= 2 * TICK_S
    half = loop.tick(10, starved=0.5).standing_s
    assert half == pytest.approx(5 * TICK_S, abs=2 * TICK_S)


def test_time_that_passes_is_no_hang(loop):
    """Stopped for an hour, then on: neither thread has moved."""
    loop.tick(3)
    judge = Standstill(os.getpid(), loop.pulse)
    assert judge.found(0.0) == ""
    assert judge.found(3600.0) == ""


def test_a_process_that_computes_and_does_not_tick_hangs(loop, monkeypatch):
    computed = {"s": 100.0}
    monkeypatch.setattr(standstill, "cpu_of", lambda _: computed["s"])
    judge = Standstill(7, loop.pulse)
    assert judge.found(0.0) == ""  # not watched yet: its interpreter begins
    computed["s"] = 200.0
    assert judge.found(10.0) == ""
    loop.tick(1)
    assert judge.found(20.0) == ""
    computed["s"] = 209.0
    assert judge.found(30.0) == ""
    computed["s"] = 211.0
    assert judge.found(40.0) == "its interpreter was held while it computed for 11.0 s"
    loop.tick(1)
    assert judge.found(50.0) == ""


def test_when_nobody_looks_nothing_hangs(loop):
    loop.tick(3)
    loop.pulse.beat(Beat(4, 1e9, math.inf))
    assert Standstill(os.getpid(), loop.pulse).found(0.0) == ""


def test_what_the_kernel_tells_is_read():
    assert cpu_of(os.getpid()) > 0.0
    assert cpu_of(2**22 + 1) == 0.0
    assert all(wait >= 0.0 for wait in waits_of_threads().values())


class Hanging:
    """A process that ends by SIGABRT, or by SIGKILL alone."""

    pid = 5

    def __init__(self, deaf):
        self.deaf, self.code = deaf, None

    def poll(self):
        return self.code

    def send_signal(self, number):
        if number == signal.SIGKILL or (number == signal.SIGABRT and not self.deaf):
            self.code = -number


@pytest.mark.parametrize("deaf", [False, True])
def test_the_agent_treats_a_hang_as_a_death(tmp_path, deaf):
    pulses = []

    def spawn(command, environment, inherit):
        assert int(environment[loop_heartbeat.VARIABLE]) in inherit
        pulses.append(Pulse(os.dup(int(environment[loop_heartbeat.VARIABLE]))))
        return Hanging(deaf)

    agent = Agent([ProcessCommand("x", ("x",), ["x"], tmp_path / "x.log")], {}, spawn)
    agent.respawn = True
    agent.start()
    assert agent.poll(0.0) == []
    pulses[0].beat(Beat(20, 5.5, 5.0))
    events = [event for now in range(1, 20) for event in agent.poll(now * 0.5)]
    assert isinstance(events[0], Died)
    assert events[0].sentence.startswith("it failed: its loop stood still for 5.5 s; where, is in its log (log: ")
    assert "started again" in events[0].sentence
    assert len(events) == 2
    assert len(pulses) == 2  # the new process has a pulse of its own, and none of the old one's past
    assert pulses[1].last() == Beat(0, 0.0, 0.0)


BEATS = """
import sys
from im_core.processes.loop_heartbeat import Beat, Pulse
from im_core.processes.procfs import cpu_of
pulse = Pulse(int(sys.argv[1]))
print("begun", flush=True)
for number in range(1, 500_000):
    pulse.beat(Beat(number, 0.0, 5.0))
"""


def test_who_reads_while_a_beat_is_told_sees_no_hang():
    pulse = Pulse.create()
    watched = Standstill(os.getpid(), pulse)
    command = [sys.executable, "-c", BEATS, str(pulse.descriptor)]
    with subprocess.Popen(command, pass_fds=[pulse.descriptor], stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        while process.poll() is None:
            assert watched.found(-1.0) == ""
    assert pulse.last() == Beat(499_999, 0.0, 5.0)
