"""Loads of tasks: rates from two reports, and the usage of a process with its children."""

import contextlib
import subprocess
import sys

import pytest

from im_bringup.tasks.loads import Load, ProcessLoad, TaskLoads
from im_core.processes.agent_socket import TaskReport
from im_core.processes.procfs import families


def report(turns=0, cpu_s=0.0, incarnation=1, requests=0, oldest_s=0.0, memory_mib=0.0, refused=0):
    return TaskReport("dom", incarnation, 2, "", {}, turns, requests, oldest_s, cpu_s, memory_mib, refused)


def test_rates_are_those_between_two_reports_two_seconds_apart():
    loads = TaskLoads()
    loads.note(report(turns=100, cpu_s=5.0), now=10.0)
    assert loads.of("dom") == Load()
    loads.note(report(turns=150, cpu_s=5.5, requests=3, oldest_s=0.7, memory_mib=80.0, refused=2), now=11.0)
    assert loads.of("dom") == Load(requests=3, oldest_s=0.7, memory_mib=80.0, refused=2)
    loads.note(report(turns=300, cpu_s=6.0), now=12.0)
    assert loads.of("dom") == Load(rate=100.0, cpu=0.5)


def test_a_new_incarnation_is_measured_anew_and_a_child_that_ended_takes_nothing_away():
    loads = TaskLoads()
    loads.note(report(turns=1000, cpu_s=9.0), now=0.0)
    loads.note(report(turns=20, cpu_s=0.2, incarnation=2), now=5.0)
    assert loads.of("dom") == Load()
    loads.note(report(turns=40, cpu_s=0.1, incarnation=2), now=9.0)
    assert loads.of("dom") == Load(rate=5.0, cpu=0.0)


def test_a_task_that_was_not_heard_has_no_load():
    assert TaskLoads().of("nobody") == Load()


@pytest.fixture
def parent():
    """A process with a child that has a child."""
    inner = "import time; time.sleep(60)"
    middle = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {inner!r}])"
    outer = f"import subprocess, sys; print('on', flush=True); subprocess.run([sys.executable, '-c', {middle!r}])"
    started = subprocess.Popen([sys.executable, "-c", outer], stdout=subprocess.PIPE)
    yield started
    for pid in families([started.pid])[started.pid]:
        with contextlib.suppress(ProcessLookupError):
            subprocess.run(["kill", "-9", str(pid)], check=False)
    started.wait()
    started.stdout.close()


def test_a_process_counts_with_its_descendants(parent, wait_until):
    wait_until(lambda: len(families([parent.pid])[parent.pid]) == 3, "the child and its child")
    usage = ProcessLoad()
    usage.look([parent.pid], now=0.0)
    alone = ProcessLoad()
    alone.look([families([parent.pid])[parent.pid][-1]], now=0.0)
    whole, part = usage.told(report(), parent.pid), alone.told(report(), families([parent.pid])[parent.pid][-1])
    assert whole.memory_mib > 2.0 * part.memory_mib > 0.0


def test_a_process_that_is_not_there_uses_nothing():
    usage = ProcessLoad()
    usage.look([2**22 - 3], now=0.0)
    assert usage.told(report(), 2**22 - 3) == report()
    assert usage.told(report(), 1) == report()
