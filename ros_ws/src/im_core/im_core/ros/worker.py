"""A thread that does in order what may block, for a node; what waits meanwhile is done together the next time."""

import queue
import threading
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from rclpy.task import Future

from im_core.errors import StateError
from im_core.ros.calls import wait
from im_core.ros.node import ManagedNode

ResultT = TypeVar("ResultT")

#: How much may wait to be done.
MOST_WAITING = 1000

#: How much is done together at most.
MOST_TOGETHER = 200


class Worker:
    """Does things in the order in which they were asked for, while the loop of the node goes on.

    Args:
        node: The node.
        name: What it is for, in messages.
        timeout_s: How long each may take, the waiting for those before it included, wall time [s].
        together: Does several things that were asked for, such as with one wait for the disk; returns what each has
            returned, or the exception that it has raised.
    """

    def __init__(
        self,
        node: ManagedNode,
        name: str,
        timeout_s: float,
        together: Callable[[Sequence[Callable[[], object]]], Sequence[object]],
    ) -> None:
        self._node, self._name, self._timeout_s, self._together = node, name, timeout_s, together
        self._work: queue.Queue[tuple[Callable[[], Any], Future] | None] = queue.Queue(MOST_WAITING)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    async def run(self, function: Callable[[], ResultT]) -> ResultT:
        """Have a function called, and await what it returns.

        Raises:
            StateError: Too much waits already.
            WaitTimeoutError: It has not ended in time; it may still have its effect.
            Exception: What the function raised.
        """
        ended = Future()
        try:
            self._work.put_nowait((function, ended))
        except queue.Full:
            raise StateError(f"{self._name}: {MOST_WAITING} requests wait already; ask again") from None
        result: ResultT = await wait(self._node, ended, self._timeout_s, f"{self._name} to answer")
        return result

    def close(self, timeout_s: float = 1.0) -> bool:
        """Do what was asked for, and end; whether it has ended within a time [s]."""
        try:
            self._work.put(None, timeout=timeout_s)
        except queue.Full:
            return False
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (first := self._work.get()) is not None:
            asked, last = [first], False
            while len(asked) < MOST_TOGETHER and not last and not self._work.empty():
                following = self._work.get()
                if following is None:
                    last = True
                else:
                    asked.append(following)
            for (_, ended), found in zip(asked, self._together([work for work, _ in asked]), strict=True):
                if isinstance(found, Exception):
                    ended.set_exception(found)
                else:
                    ended.set_result(found)
            if last:
                return
