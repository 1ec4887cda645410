"""Who is alive: follows the heartbeats of all tasks, and waits for answers only while the answerer lives."""

from dataclasses import dataclass
from typing import Any

from im_core import clock
from im_core.errors import LinkError, WaitTimeoutError
from im_core.ros import qos
from im_core.ros.node import STATUS_TOPIC, ManagedNode
from im_msgs.msg import TaskStatus

#: A task that has not been heard for this long is missing [s] of wall time.
SILENCE_S = 6.0
CHECK_PERIOD_S = 0.25


@dataclass(frozen=True)
class Heartbeat:
    """Last sign of life of a task: its incarnation, and when it was heard [s]."""

    incarnation: int
    heard: float


class Heartbeats:
    """Follows ``/im/task_status``.

    Args:
        node: The node that listens.
    """

    def __init__(self, node: ManagedNode) -> None:
        self._node = node
        self._born = clock.monotonic()
        self._last: dict[str, Heartbeat] = {}
        node.create_subscription(TaskStatus, STATUS_TOPIC, self._hear, qos.STATUS)

    def incarnation(self, task: str) -> int | None:
        """Incarnation of a task, None if it was never heard."""
        last = self._last.get(task)
        return last.incarnation if last else None

    def missing(self, task: str, since: int | None = None) -> str:
        """Why a task cannot answer, or an empty string.

        Args:
            task: Its name.
            since: Incarnation that was asked; another one does not know of it.
        """
        last = self._last.get(task)
        silence = clock.monotonic() - (last.heard if last else self._born)
        if silence > SILENCE_S:
            return f"{task} is missing (last heard {silence:.1f} s ago)" if last else f"{task} is missing (never heard)"
        if since is not None and last is not None and last.incarnation != since:
            return f"{task} is missing (it died and was started again meanwhile)"
        return ""

    async def wait(self, future: Any, task: str, timeout_s: float, what: str) -> Any:
        """Await a future that ``task`` will complete.

        Args:
            future: Future of rclpy.
            task: Name of the task that answers.
            timeout_s: Longest wait, wall time [s].
            what: What is waited for.

        Raises:
            LinkError: The task died; named.
            WaitTimeoutError: No answer in time.
        """
        promise = self._node.promise()
        since = self.incarnation(task)
        deadline = clock.monotonic() + timeout_s

        def settle(reason: str) -> None:
            if not promise.done():
                promise.set_result(reason)

        def check() -> None:
            if clock.monotonic() > deadline:
                settle("late")
            elif self.missing(task, since):
                settle("missing")

        timer = self._node.create_timer(CHECK_PERIOD_S, check, clock=self._node.steady_clock)
        future.add_done_callback(lambda _: settle("done"))
        try:
            reason = await promise
        finally:
            self._node.destroy_timer(timer)
        if future.done():
            return future.result()
        if reason == "late":
            raise WaitTimeoutError(what=what, seconds=timeout_s)
        raise LinkError(f"{self.missing(task, since)} while waited for {what}", task=task)

    def _hear(self, message: TaskStatus) -> None:
        self._last[message.name] = Heartbeat(int(message.incarnation), clock.monotonic())
