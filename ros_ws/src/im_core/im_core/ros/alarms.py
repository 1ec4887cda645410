"""Functions called after a time: any number of them, with one timer of the middleware."""

import heapq
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from im_core import clock

_FEW = 64
_SOON_S = 1e-6


@dataclass(eq=False)
class Alarm:
    """A function that is to be called once; None when it was, or is not wanted any more."""

    call: Callable[[], None] | None


class Alarms:
    """Calls functions in the loop of a node, in wall time. What waits and is not due costs nothing.

    Args:
        node: The node; anything with ``create_timer`` and a ``steady_clock``.
    """

    def __init__(self, node: Any) -> None:
        self._heap: list[tuple[float, int, Alarm]] = []
        self._count = 0
        self._cancelled = 0
        self._timer = node.create_timer(1.0, self._strike, clock=node.steady_clock)
        self._timer.cancel()

    def after(self, seconds: float, call: Callable[[], None]) -> Alarm:
        """Has a function called after a time [s]; from the loop."""
        alarm = Alarm(call)
        self._count += 1
        heapq.heappush(self._heap, (clock.monotonic() + seconds, self._count, alarm))
        if self._heap[0][2] is alarm:
            self._set()
        return alarm

    def cancel(self, alarm: Alarm) -> None:
        """Takes an alarm back, if its function was not called yet."""
        if alarm.call is None:
            return
        alarm.call = None
        self._cancelled += 1
        if self._cancelled > _FEW and 2 * self._cancelled > len(self._heap):
            self._heap = [entry for entry in self._heap if entry[2].call is not None]
            heapq.heapify(self._heap)
            self._cancelled = 0

    def _strike(self) -> None:
        self._timer.cancel()
        now = clock.monotonic()
        while self._heap and self._heap[0][0] <= now:
            alarm = heapq.heappop(self._heap)[2]
            call, alarm.call = alarm.call, None
            if call is None:
                self._cancelled -= 1
            else:
                call()
        self._set()

    def _set(self) -> None:
        if self._heap:
            left = max(_SOON_S, self._heap[0][0] - clock.monotonic())
            self._timer.timer_period_ns = round(1e9 * left)
            self._timer.reset()
