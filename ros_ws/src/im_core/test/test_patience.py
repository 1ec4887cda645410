"""Silence of a process is counted while it could speak: not while a busy computer keeps it from the processor."""

import os
import signal
import subprocess
import sys

import pytest

from im_core import clock
from im_core.patience import Patience, Silence

SPIN = "while True: pass"
SLEEP = "import time; time.sleep(600)"


@pytest.fixture
def child():
    children = []

    def start(program: str, cores: set[int] | None = None, niceness: int = 0) -> int:
        process = subprocess.Popen(
            [sys.executable, "-c", f"import os; os.nice({niceness}); print(flush=True)\n{program}"],
            stdout=subprocess.PIPE,
            preexec_fn=lambda: os.sched_setaffinity(0, cores) if cores else None,
        )
        children.append(process)
        process.stdout.readline()
        return process.pid

    yield start
    for process in children:
        process.kill()
        process.wait()


def listen(pid: int, until: float, limit: float = 60.0) -> Silence:
    """Looks until so much silence is counted, or ``limit`` has passed."""
    silence, began = Silence(pid), clock.monotonic()
    while silence.look() < until and clock.monotonic() < began + limit:
        clock.sleep(0.02)
    return silence


def test_who_sleeps_is_silent(child):
    assert listen(child(SLEEP), 0.3).seconds >= 0.3


def test_who_is_stopped_is_silent(child):
    pid = child(SPIN)
    os.kill(pid, signal.SIGSTOP)
    assert listen(pid, 0.3).seconds >= 0.3


def test_who_is_gone_is_silent():
    assert listen(0, 0.2).seconds >= 0.2


def test_who_computes_is_silent_for_as_long_as_it_computes(child):
    assert listen(child(SPIN), 0.3).seconds >= 0.3


def test_who_is_kept_from_the_processor_is_not_silent(child):
    """Beside two others on one core, which are not as nice, it has a small part of it."""
    core = {max(os.sched_getaffinity(0))}
    pid = child(SPIN, core, 19)
    for _ in range(2):
        child(SPIN, core)
    assert listen(pid, 10.0, limit=1.5).seconds < 0.75


def test_time_in_which_nobody_looked_does_not_count(child):
    silence = Silence(child(SLEEP), longest_look_s=0.05)
    clock.sleep(0.2)
    assert 0.0 < silence.look() <= 0.05


def test_patience_waits_for_whoever_is_kept_from_the_processor(child):
    """Others that sleep, or have ended, may wait for it."""
    core = {max(os.sched_getaffinity(0))}
    late = child(SPIN, core, 19)
    for _ in range(2):
        child(SPIN, core)
    patience, began = Patience([child(SLEEP), late, 0]), clock.monotonic()
    while clock.monotonic() < began + 1.5:
        patience.look()
        clock.sleep(0.02)
    assert patience.seconds < 0.75


def test_patience_ends_with_who_could_end_and_does_not(child):
    patience, began = Patience([child(SLEEP), child(SLEEP)]), clock.monotonic()
    while patience.look() < 0.3:
        assert clock.monotonic() < began + 60.0
        clock.sleep(0.02)
    assert clock.monotonic() - began >= 0.3
