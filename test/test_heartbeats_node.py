"""Who is missing: a task that is silent, not one that a busy node has not come to hear."""

import os
import signal
import subprocess
import sys
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest
from rclpy.task import Future

from im_bringup.tasks.middleware import loopback_profile, open_profile
from im_core import patience
from im_core.errors import LinkError, WaitTimeoutError
from im_core.processes.agent_socket import TaskIncarnation
from im_core.ros import heartbeats
from im_core.ros.heartbeats import CHECK_PERIOD_S, LEASE_S, SILENCE_S, Heartbeats
from im_core.ros.node import ManagedNode
from im_msgs.msg import TaskStatus


@pytest.fixture
def followed(ros, monkeypatch):
    """The heartbeats that a node follows, by a clock that stands still: ``followed.time[0]``."""
    node = ManagedNode("listener")
    ros(node)
    time = [100.0]
    for module in (heartbeats, patience):
        monkeypatch.setattr(module, "clock", SimpleNamespace(monotonic=lambda: time[0]))
    followed = Heartbeats(node)
    followed.time = time
    return followed


def beat_of(name, process, incarnation=1):
    return TaskStatus(name=name, host=os.uname().nodename, pid=process, incarnation=incarnation)


@pytest.fixture
def child():
    """A process that waits."""
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        yield child
        child.kill()


def test_a_task_is_not_missing_because_the_node_was_busy_and_did_not_hear_it(followed, child):
    """Its heartbeats wait in the queue meanwhile; after that, silence counts."""
    lost = []
    followed._hear(beat_of("back", child.pid))
    followed.watch("back", 1, lost.append)
    for busy_s in (0.0, 30.0, 0.0, 60.0):
        followed.time[0] += busy_s
        followed._check()
    assert lost == []
    child.send_signal(signal.SIGSTOP)
    os.waitpid(child.pid, os.WUNTRACED)  # until then it may wait for a processor, which is no silence
    for _ in range(int(SILENCE_S / CHECK_PERIOD_S) + 1):
        followed.time[0] += CHECK_PERIOD_S
        followed._check()
    assert lost[0].startswith("back is missing (last heard 9")


def test_who_asks_late_is_told_at_once_of_a_dead_task_and_not_of_one_that_lives(followed, child):
    followed._node.incarnations = {"back": TaskIncarnation(1, child.pid, False)}
    followed.missing("front")  # asked for: it is none of the machine, and its number may be of another host
    for task in ("back", "front"):
        followed._hear(beat_of(task, child.pid))
    followed.time[0] += 30.0
    assert followed.missing("back") == ""
    child.kill()
    child.wait()
    ended = f"back is missing (its process {child.pid} has ended)"
    assert followed.missing("back") == ended
    followed._hear(beat_of("back", child.pid))  # waited in the queue
    assert followed.missing("back") == ended
    assert followed.missing("front") == ""
    followed._hear(beat_of("front", child.pid))
    followed.time[0] += 30.0
    assert followed.missing("front") == "front is missing (last heard 30.0 s ago)"
    assert followed.missing("nobody") == ""
    for _ in range(int(SILENCE_S / CHECK_PERIOD_S) + 1):
        followed.time[0] += CHECK_PERIOD_S
        silence_of_nobody = followed.missing("nobody")
    assert silence_of_nobody == "nobody is missing (never heard)"


def test_in_a_machine_only_the_agent_says_that_a_task_has_begun_anew_or_starts(followed):
    node, lost, begun = followed._node, [], []
    node.incarnations = {"back": TaskIncarnation(1, 0, False), "front": TaskIncarnation(0, 0, False)}
    followed.on_incarnation(lambda *told: begun.append(told))
    followed._hear(beat_of("back", 0))
    followed.watch("back", 1, lost.append)
    for name, incarnation in (("back", 2), ("back", 0), ("front", 0), ("front", 7)):
        followed._hear(beat_of(name, os.getpid(), incarnation))  # made up
    followed._hear(TaskStatus(name="back", incarnation=1, phase=TaskStatus.LOADED, pid=os.getpid()))
    assert (lost, begun) == ([], [("back", False)])
    assert (followed.incarnation("back"), followed.incarnation("front")) == (1, None)
    assert not followed.starting("back")
    node.incarnations = {"back": TaskIncarnation(2, 0, True)}
    assert followed.starting("back")
    followed._hear(beat_of("back", 0, 2))
    assert (begun[1:], followed.incarnation("back")) == ([("back", True)], 2)
    assert lost == ["back is missing (it died and was started again meanwhile)"]


def test_of_made_up_tasks_nothing_is_kept(followed):
    followed._node.incarnations = {"back": TaskIncarnation(1, 0, False)}
    followed.missing("asked")
    for number in range(2 * heartbeats.MOST_TASKS):
        followed._hear(beat_of(f"made_up_{number}", 1))
    for name in ("back", "asked"):
        followed._hear(beat_of(name, 0))
    assert set(followed._last) == {"back", "asked"}
    assert set(followed._silences) == {"asked"}
    followed._node.incarnations = None
    for number in range(2 * heartbeats.MOST_TASKS):
        followed._hear(beat_of(f"made_up_{number}", 1))
    assert len(followed._last) == heartbeats.MOST_TASKS


def test_a_task_of_another_host_is_silent_whatever_runs_here_under_its_number(followed):
    followed._hear(TaskStatus(name="back", host="elsewhere", pid=os.getpid(), incarnation=1))
    followed.time[0] += SILENCE_S + 1.0
    assert followed.missing("back") == "back is missing (last heard 7.0 s ago)"


def test_who_was_stopped_for_longer_than_the_lease_of_dds_waits_no_more_for_what_may_be_lost(followed, wait_until):
    followed._hear(TaskStatus(name="back", host="elsewhere", incarnation=1))
    ended = []

    async def ask():
        try:
            await followed.wait(Future(), "back", 3600.0, "an answer")
        except LinkError as error:
            ended.append(error.message)

    followed._node.spawn(ask())
    wait_until(lambda: followed._owed, "the wait")
    followed.time[0] += LEASE_S - 1.0
    followed._hear(TaskStatus(name="back", host="elsewhere", incarnation=1))
    followed._check()
    assert followed._owed
    followed.time[0] += LEASE_S + 1.0
    followed._hear(TaskStatus(name="back", host="elsewhere", incarnation=1))  # it was there all the while
    followed._check()
    wait_until(lambda: ended, "the end")
    assert ended == ["listener stood still for 21 s, and an answer may be lost while waited for an answer"]
    assert not followed._owed


def test_what_is_not_waited_for_any_longer_is_given_up(followed, wait_until):
    """A client keeps each call until it has been answered or given up."""
    answer, ended = Future(), []

    async def ask():
        try:
            await followed.wait(answer, "back", 0.1, "an answer")
        except WaitTimeoutError as error:
            ended.append(error)

    followed._node.spawn(ask())
    wait_until(lambda: ended, "the end")
    assert answer.cancelled()


@pytest.mark.parametrize("profile", [loopback_profile(), open_profile()])
def test_the_lease_is_that_of_the_profiles(profile):
    lease = ElementTree.parse(profile).find(".//{*}leaseDuration/{*}sec")
    assert float(lease.text) == LEASE_S
