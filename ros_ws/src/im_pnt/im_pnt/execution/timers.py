"""Timers in order: deadlines of actions, delays of transitions, questions, clocks of guards."""

import heapq
from collections.abc import Callable
from dataclasses import dataclass

_FEW = 64


@dataclass(slots=True, eq=False)
class Timer:
    """Timer for one strike; ``act`` is None after the strike or the cancellation.

    Attributes:
        time: When [s].
        act: What.
    """

    time: float
    act: Callable[[], None] | None


class Timers:
    """Timers by the time. A cancelled timer costs only the place, until swept out."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, Timer]] = []
        self._count = 0
        self._cancelled = 0

    def at(self, time: float, act: Callable[[], None]) -> Timer:
        """Has something done at a time [s]."""
        timer = Timer(time, act)
        self._count += 1
        heapq.heappush(self._heap, (time, self._count, timer))
        return timer

    def cancel(self, timer: Timer | None) -> None:
        """Cancel a timer not yet expired."""
        if timer is None or timer.act is None:
            return
        timer.act = None
        self._cancelled += 1
        if self._cancelled > _FEW and self._cancelled > len(self._heap) // 2:
            self._heap = [entry for entry in self._heap if entry[2].act is not None]
            heapq.heapify(self._heap)
            self._cancelled = 0

    def strike(self, now: float) -> bool:
        """Strike the timers due at a time, in order [s]; return whether there was one."""
        struck = False
        while (due := self.next()) is not None and due <= now:
            timer = heapq.heappop(self._heap)[2]
            act, timer.act = timer.act, None
            if act is not None:
                struck = True
                act()
        return struck

    def next(self) -> float | None:
        """Return the time of the next :meth:`strike` [s], None: never."""
        while self._heap and self._heap[0][2].act is None:
            heapq.heappop(self._heap)
            self._cancelled -= 1
        return self._heap[0][0] if self._heap else None
