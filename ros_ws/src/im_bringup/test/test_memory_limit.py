"""A process that grows ends at its limit, and what it ended by is named."""

import math
import os
import resource
import signal
import subprocess
import sys

import pytest

from im_bringup.tasks import agent as agents
from im_bringup.tasks import memory_limit, receivers
from im_bringup.tasks.agent import Agent, Died, ProcessCommand
from im_bringup.tasks.memory_limit import excess, limit_memory, refused
from im_bringup.tasks.receivers import STUCK_S, Receivers
from im_core import clock
from im_core.processes.procfs import private_bytes, thread_name, threads_of, waits_of

LIMIT_MIB = 128

GROWS = """
import mmap, sys
reserved = mmap.mmap(-1, 1 << 30)  # shared: what others see, too
held = []
try:
    while True:
        held.append(bytearray(1 << 20))
except MemoryError:
    if sys.argv[1] == "ends":
        raise
    print(len(held), flush=True)
    __import__("time").sleep(600.0)
"""


def agent_of(tmp_path, way):
    argv = [sys.executable, "-c", GROWS, way]
    agent = Agent([ProcessCommand("x", ("x",), argv, tmp_path / "x.log", LIMIT_MIB)], dict(os.environ))
    agent.start()
    return agent


def death(agent):
    """What is told of the process of an agent that ends."""
    deadline = clock.monotonic() + 60.0
    while clock.monotonic() < deadline:
        for event in agent.poll(clock.monotonic()):
            assert isinstance(event, Died)
            return event.sentence
        clock.sleep(0.02)
    pytest.fail("it has not ended")


@pytest.fixture
def unwatched(monkeypatch):
    """No process is ended before it is refused memory."""
    monkeypatch.setattr(agents, "excess", lambda *_: "")


def test_a_process_that_is_refused_memory_ends_and_is_named(tmp_path, unwatched):
    told = death(agent_of(tmp_path, "ends"))
    assert told.startswith(f"it ended: it asked for more memory than its limit of {LIMIT_MIB} MiB (log: ")


def test_a_process_that_goes_on_without_memory_is_ended(tmp_path):
    told = death(agent_of(tmp_path, "stays"))
    assert told.startswith("it failed: it has taken ")
    assert f" MiB of memory, and its limit is {LIMIT_MIB} MiB; where, is in its log" in told


def test_shared_memory_does_not_count(tmp_path, unwatched):
    agent, log = agent_of(tmp_path, "stays"), tmp_path / "x.log"
    deadline = clock.monotonic() + 60.0
    while not (told := log.read_text()).endswith("\n") and clock.monotonic() < deadline:
        clock.sleep(0.02)
    agent.shut_down()
    assert LIMIT_MIB / 2 < int(told) < LIMIT_MIB


def test_a_lower_limit_of_the_user_stays():
    child = subprocess.Popen(
        [sys.executable, "-c", "import sys; sys.stdin.read()"],
        stdin=subprocess.PIPE,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_DATA, (64 << 20, 64 << 20)),
    )
    limit_memory(LIMIT_MIB, child.pid)
    assert resource.prlimit(child.pid, resource.RLIMIT_DATA) == (64 << 20, 64 << 20)
    child.communicate()
    limit_memory(LIMIT_MIB, child.pid)  # it is gone


def test_what_a_process_has_taken_is_compared_with_its_limit(monkeypatch):
    monkeypatch.setattr(memory_limit, "private_bytes", lambda _: 96 << 20)
    assert excess(1, 102) == ""
    assert excess(1, 101) == "it has taken 96 MiB of memory, and its limit is 101 MiB"


@pytest.mark.parametrize(
    ("code", "last", "named"),
    [
        (-signal.SIGABRT, "terminate called after throwing an instance of 'std::bad_alloc'", True),
        (-signal.SIGABRT, "  what():  low-level allocator is out of memory: foonathan::memory::out_of_memory", True),
        (1, "MemoryError", True),
        (1, "ValueError", False),
        (0, "MemoryError", False),
    ],
)
def test_a_refusal_is_read_from_the_log_of_this_process(tmp_path, code, last, named):
    log = tmp_path / "x.log"
    log.write_text(f"MemoryError of the one before\n{last}\nThread 1:\n")
    assert refused(code, log, len("MemoryError of the one before\n")) is named


class Threads:
    """Threads as the kernel tells of them: name, waits and CPU time by number."""

    def __init__(self, monkeypatch):
        self.told, self.now = {}, 0.0
        monkeypatch.setattr(receivers, "cpu_of", lambda _: self.now)
        monkeypatch.setattr(receivers, "threads_of", lambda _: list(self.told))
        monkeypatch.setattr(receivers, "thread_name", lambda _, thread: self.told[thread][0])
        monkeypatch.setattr(receivers, "waits_of", lambda _, thread: self.told[thread][1:])
        self.judge = Receivers(7)

    def after(self, name, waits, ran_s):
        """What is found where a thread has run for so long."""
        self.told[1] = (name, waits, ran_s)
        self.now += 2.0
        return self.judge.found(self.now)


def test_a_thread_of_the_middleware_that_never_waits_is_stuck(monkeypatch):
    threads = Threads(monkeypatch)
    assert threads.after("dds.udp.7411", 3, 0.0) == ""
    assert threads.after("dds.udp.7411", 3, STUCK_S - 1.0) == ""
    found = threads.after("dds.udp.7411", 3, STUCK_S)
    assert found == f"its thread dds.udp.7411 computed for {STUCK_S:.1f} s in one packet"


def test_a_thread_that_waits_now_and_then_is_busy(monkeypatch):
    threads = Threads(monkeypatch)
    assert not any(threads.after("dds.udp.7411", look, 0.9 * STUCK_S * look) for look in range(20))


def test_threads_of_others_may_compute(monkeypatch):
    threads = Threads(monkeypatch)
    assert not any(threads.after("python", 1, STUCK_S * look) for look in range(20))


def test_what_the_kernel_tells_of_threads_and_memory_is_read():
    me = os.getpid()
    assert me in threads_of(me)
    assert thread_name(me, me)
    before, _ = waits_of(me, me)
    clock.sleep(0.01)
    after, ran_s = waits_of(me, me)
    assert after > before
    assert ran_s > 0.0
    assert private_bytes(me) > 10 << 20
    nobody = 2**22 + 1
    assert threads_of(nobody) == []
    assert thread_name(nobody, nobody) == ""
    assert waits_of(nobody, nobody) is None
    assert private_bytes(nobody) == 0
    assert excess(nobody, 1) == ""
    assert Receivers(nobody).found(math.inf) == ""
