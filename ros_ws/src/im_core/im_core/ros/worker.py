"""Thread for blocking work of a node, in order; work waiting meanwhile is done together the next time."""

import queue
import threading
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

from im_core import clock
from im_core.errors import StateError, WaitTimeoutError
from im_core.ros.coroutines import Promise, calling
from im_core.ros.node import ManagedNode

ResultT = TypeVar("ResultT")

#: How much may wait to be done.
MOST_WAITING = 1000

#: How much is done together at most.
MOST_TOGETHER = 200

#: Who was answered together asks again at about the same time, the first of which would else have the disk for itself
#: while the others wait for it. Half of those who ask at once are waited for, so long for each [s]: while these are
#: served, the others take their answers and ask again; and how seldom is looked [s].
GATHER_S = 0.0002
LOOK_S = 0.0005
#: And as long as it took before, where a computer or a disk is busy, but at most so long [s].
MOST_GATHER_S = 0.05


class Worker:
    """Worker for functions in the order of the calls, while the loop of the node goes on.

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
        self._work: queue.SimpleQueue[tuple[Callable[[], Any], Promise, Callable[[Any], None]] | None]
        self._work = queue.SimpleQueue()
        self._asked: deque[tuple[float, Promise]] = deque()  # when each is late, in their order; of the loop
        self._watching = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    async def run(self, function: Callable[[], ResultT], late: Callable[[ResultT], None] = lambda _: None) -> ResultT:
        """Call a function in the worker, and await the return value.

        Args:
            function: The function.
            late: Called in the loop with what it returned, if that was when nobody waited for it any more.

        Raises:
            StateError: Too much waits already.
            WaitTimeoutError: It has not ended in time; it may still have its effect.
            Exception: What the function raised.
        """
        if self._work.qsize() >= MOST_WAITING:
            raise StateError(f"{self._name}: {MOST_WAITING} requests wait already, as many as allowed; ask again later")
        ended = self._node.promise()
        self._work.put((function, ended, late))
        self._asked.append((clock.monotonic() + self._timeout_s, ended))
        if not self._watching:
            self._watch()
        while self._asked and self._asked[0][1].done():
            self._asked.popleft()
        result: ResultT = await ended
        return result

    def _watch(self) -> None:
        """End late requests, and check again at the next due time: requests get late in order of arrival."""
        now = clock.monotonic()
        while self._asked and (self._asked[0][1].done() or self._asked[0][0] <= now):
            _, ended = self._asked.popleft()
            if not ended.done():
                ended.set_exception(WaitTimeoutError(what=f"{self._name} to answer", seconds=self._timeout_s))
        self._watching = bool(self._asked)
        if self._asked:
            self._node.alarms.after(self._asked[0][0] - now, self._watch)

    def close(self, timeout_s: float = 1.0) -> bool:
        """Finish the requested work, and end; return whether ended within a time [s]."""
        self._work.put(None)
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        several, took_s = 1, 0.0
        while (first := self._work.get()) is not None:
            asked, last = [first], False
            if several > 1:
                self._gather(several, took_s)
            while len(asked) < MOST_TOGETHER and not last and not self._work.empty():
                following = self._work.get()
                if following is None:
                    last = True
                else:
                    asked.append(following)
            began = clock.monotonic()
            done = self._done([work for work, _, _ in asked])
            took_s = clock.monotonic() - began
            for (_, ended, late), found in zip(asked, done, strict=True):
                if ended.done():
                    if not isinstance(found, Exception):
                        self._node.spawn(calling(partial(late, found)))
                elif isinstance(found, Exception):
                    ended.set_exception(found)
                else:
                    ended.set_result(found)
            several = max((len(asked) + self._work.qsize() + 1) // 2, several // 2)
            if last:
                return

    def _done(self, works: Sequence[Callable[[], object]]) -> Sequence[object]:
        try:
            return self._together(works)
        except BaseException as error:  # the thread goes on, whatever foreign code raises
            return [StateError(f"{self._name} broke: {error!r}")] * len(works)

    def _gather(self, several: int, took_s: float) -> None:
        """Wait for the given number of requests, little longer than the service of the requests before [s]."""
        deadline = clock.monotonic() + several * GATHER_S + min(took_s, MOST_GATHER_S)
        while (missing := several - 1 - self._work.qsize()) > 0 and clock.monotonic() < deadline:
            clock.sleep(max(LOOK_S, missing * GATHER_S / 2))
