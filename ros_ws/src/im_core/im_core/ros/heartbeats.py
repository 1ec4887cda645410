"""Liveness of tasks: follow the heartbeats, and wait for answers only while the answering task lives.

Every participant of DDS can publish a heartbeat. A heartbeat of a task of the machine counts only if the agent of this
process vouches for its incarnation (:attr:`im_core.ros.node.ManagedNode.incarnations`). The agent alone says whether
the task starts. A made-up heartbeat can then only hide the silence of a task that is stopped. In a process that no
agent has started every heartbeat counts.
"""

import socket
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from im_core import clock
from im_core.errors import LinkError, WaitTimeoutError
from im_core.patience import Silence
from im_core.processes.agent_socket import TaskIncarnation
from im_core.processes.procfs import ProcessId, stat_fields
from im_core.processes.startup import STATUS_TOPIC
from im_core.ros import qos
from im_core.ros.node import ManagedNode
from im_msgs.msg import TaskStatus

#: A task that has not been heard for this long is missing [s], as :class:`im_core.patience.Silence` counts.
SILENCE_S = 6.0
CHECK_PERIOD_S = 0.25

#: DDS takes a process that says nothing for so long [s] for gone, and drops what it owes it; as fastdds.xml says.
LEASE_S = 20.0

#: Tasks that are followed where no agent tells which there are.
MOST_TASKS = 1000

_UNKNOWN = -1
_NO_PROCESS = ProcessId(0, _UNKNOWN)
_STARTING = (TaskStatus.LOADED, TaskStatus.CONFIGURED)


@dataclass(frozen=True)
class Heartbeat:
    """Last heartbeat of a task: incarnation, time of the incarnation's first heartbeat, time of the last heartbeat [s].

    ``process`` has pid 0 where it is none of this host, and no start where no agent vouches for the pid: another host
    or container may have this name. ``starting``: it has not passed all phases of its start yet. Of a task that was
    asked for and not heard yet ``incarnation`` is None, and the times are that of the question.
    """

    incarnation: int | None
    since: float
    heard: float
    process: ProcessId
    starting: bool


@dataclass(eq=False)
class TaskWatch:
    """Pending wait for a task.

    Attributes:
        since: Incarnation that was asked; None: whichever answers.
        lost: Called when the task is missing, with the reason.
    """

    since: int | None
    lost: Callable[[str], None]


class Heartbeats:
    """Follows ``/im/task_status``. However many wait, a silent task is looked for once, and only while somebody waits.

    In a machine only its tasks are followed, and those that were asked for: names that somebody makes up are not kept.

    A task of this host that the agent vouches for is missing as soon as its process has ended. Of silence, neither the
    time counts in which this node came to hear nobody, for its loop was busy, nor that in which a task of this host
    waited for a processor.
    """

    def __init__(self, node: ManagedNode) -> None:
        self._node = node
        self._host = socket.gethostname()
        self._last: dict[str, Heartbeat] = {}
        self._silences: dict[str, tuple[float, Silence]] = {}
        self._watches: dict[str, dict[TaskWatch, None]] = {}
        self._begun: list[Callable[[str, bool], None]] = []
        self._check_timer = node.create_timer(CHECK_PERIOD_S, self._check, clock=node.steady_clock)
        self._check_timer.cancel()
        self._checked = 0.0
        self._owed: dict[Callable[[str], None], None] = {}
        node.create_subscription(TaskStatus, STATUS_TOPIC, self._hear, qos.STATUS)

    def incarnation(self, task: str) -> int | None:
        """Return the incarnation of a task, None if never heard."""
        return self._followed(task).incarnation

    def heard_since(self, task: str) -> float | None:
        """Return the first heartbeat time of a task's present incarnation (monotonic) [s], None if never heard."""
        last = self._followed(task)
        return None if last.incarnation is None else last.since

    def starting(self, task: str) -> bool:
        """Return whether a task was last heard during the start: services are there, but not usable yet."""
        vouched = self._vouched(task)
        return self._followed(task).starting if vouched is None else vouched.starting

    def missing(self, task: str, since: int | None = None) -> str:
        """Why a task cannot answer, or an empty string.

        Args:
            task: Its name.
            since: Incarnation that was asked; another one does not know of it.
        """
        last = self._followed(task)
        if last.process.ended():
            return f"{task} is missing (its process {last.process.pid} has ended)"
        if self._silence_s(task, last) > SILENCE_S:
            never = last.incarnation is None
            ago = "never heard" if never else f"last heard {clock.monotonic() - last.heard:.1f} s ago"
            return f"{task} is missing ({ago})"
        if since is not None and last.incarnation != since:
            return f"{task} is missing (it died and was started again meanwhile)"
        return ""

    def _followed(self, task: str) -> Heartbeat:
        """The last heartbeat of a task, which is followed from now on."""
        last = self._last.get(task)
        if last is None:
            now = clock.monotonic()
            last = self._last[task] = Heartbeat(None, since=now, heard=now, process=_NO_PROCESS, starting=False)
        return last

    def _vouched(self, task: str) -> TaskIncarnation | None:
        """Return the agent's record of a task; None for tasks outside the machine, or without an agent."""
        return None if self._node.incarnations is None else self._node.incarnations.get(task)

    def _room(self) -> bool:
        """Return whether there is room to follow a task neither requested by anyone nor known to an agent."""
        return self._node.incarnations is None and len(self._last) < MOST_TASKS

    def _silence_s(self, task: str, last: Heartbeat) -> float:
        known = self._silences.get(task)
        if known is None or known[0] != last.heard:
            so_far = 0.0 if stat_fields(last.process.pid) else clock.monotonic() - last.heard
            silence = Silence(last.process.pid, so_far, longest_look_s=2.0 * CHECK_PERIOD_S)
            known = self._silences[task] = last.heard, silence
        return known[1].look()

    def watch(self, task: str, since: int | None, lost: Callable[[str], None]) -> Callable[[], None]:
        """Have a function called when a task goes missing; return the function to end the watch."""
        watch = TaskWatch(since, lost)
        if not self._watches:
            self._checked = clock.monotonic()
            self._check_timer.reset()
        self._watches.setdefault(task, {})[watch] = None

        def unwatch() -> None:
            watches = self._watches.get(task, {})
            watches.pop(watch, None)
            if not watches:
                self._watches.pop(task, None)

        return unwatch

    def on_incarnation(self, begun: Callable[[str, bool], None]) -> None:
        """Register a function, called with each task that a new incarnation is heard of.

        Args:
            begun: Takes the name, and whether a former incarnation was heard. An incarnation that dies early may be
                heard by nobody, though its services have answered.
        """
        self._begun.append(begun)

    async def wait(self, future: Any, task: str, timeout_s: float, what: str) -> Any:
        """Await a future to be completed by ``task``.

        An answer that comes while this process is stopped for longer than :data:`LEASE_S` is lost.

        Args:
            future: Future of rclpy; cancelled where it is not waited for any longer.
            task: Name of the task that answers.
            timeout_s: Longest wait, wall time [s].
            what: What is waited for.

        Raises:
            LinkError: The task died; named. Or this process was stopped for so long that the answer may be lost.
            WaitTimeoutError: No answer in time.
        """
        promise = self._node.promise()

        def settle(missing: str) -> None:
            if not promise.done():
                promise.set_result(missing)

        alarm = self._node.alarms.after(timeout_s, lambda: settle(""))
        unwatch = self.watch(task, self.incarnation(task), settle)
        future.add_done_callback(lambda _: settle(""))
        self._owed[settle] = None
        try:
            missing = await promise
        finally:
            del self._owed[settle]
            unwatch()
            self._node.alarms.cancel(alarm)
            future.cancel()  # no effect on one that is done; else its client would keep it for ever
        if future.done():
            return future.result()
        if missing:
            raise LinkError(f"{missing} while waited for {what}", task=task)
        raise WaitTimeoutError(what=what, seconds=timeout_s)

    def _hear(self, message: TaskStatus) -> None:
        vouched = self._vouched(message.name)
        if vouched is not None and message.incarnation != (vouched.incarnation or None):
            return  # of a former incarnation, of one that the agent will tell of, or made up
        if vouched is None and message.name not in self._last and not self._room():
            return
        known, now = self._followed(message.name), clock.monotonic()
        starting = message.phase in _STARTING
        if known.incarnation == message.incarnation:
            self._last[message.name] = replace(known, heard=now, starting=starting)
            return
        pid = message.pid if message.host == self._host else 0
        process = ProcessId(pid, _UNKNOWN) if vouched is None else ProcessId.of(vouched.pid)
        self._last[message.name] = Heartbeat(message.incarnation, now, now, process, starting)
        again = known.incarnation is not None
        if again:
            self._tell(message.name)
        for begun in self._begun:
            begun(message.name, again)

    def _check(self) -> None:
        if not self._watches:
            self._check_timer.cancel()
        now = clock.monotonic()
        stood_s, self._checked = now - self._checked, now
        if stood_s > LEASE_S:  # this process was stopped
            for settle in list(self._owed):
                settle(f"{self._node.get_name()} stood still for {stood_s:.0f} s, and an answer may be lost")
        for task in list(self._watches):
            if self.missing(task):
                self._tell(task)

    def _tell(self, task: str) -> None:
        for watch in list(self._watches.get(task, ())):
            missing = self.missing(task, watch.since)
            if missing:
                watch.lost(missing)
