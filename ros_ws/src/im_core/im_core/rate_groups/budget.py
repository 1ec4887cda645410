"""Time limit of a call within a loop: the call ends, not the loop."""

import os
import signal
import threading
from collections.abc import Callable
from types import FrameType

from im_core import clock
from im_core.errors import ImError, StateError
from im_core.processes.procfs import scheduled

_SHORTEST_S = 5e-4


class BudgetError(ImError):
    """Call that took longer than its budget."""

    default_code = "budget"


class _Timeout(BaseException):
    """End of a call from outside; no error, so that a function that catches errors ends as well."""


class Budget:
    """Limit of the time that a call takes, also of one that never returns.

    Time counts whether the function computes or waits; time in which a busy computer gave the thread no processor does
    not. A call into C ends when C returns.

    Raises:
        StateError: Made in another thread than the main one, which alone gets alarms.
    """

    def __init__(self) -> None:
        if threading.current_thread() is not threading.main_thread():
            raise StateError("a function with a budget runs in the main thread only")
        self._pid = os.getpid()
        self._began = self._queued = self._seconds = 0.0
        self._called = False

    def call(self, function: Callable[[float], object], time_s: float, seconds: float) -> None:
        """Call a function.

        Args:
            function: What to call.
            time_s: What to call it with.
            seconds: Most that the call may take [s].

        Raises:
            BudgetError: It took longer.
        """
        handler, timer = signal.signal(signal.SIGALRM, self._on_alarm), signal.getitimer(signal.ITIMER_REAL)
        self._began, self._queued, self._seconds = clock.monotonic(), self._queued_s(), seconds
        try:
            self._called = True
            signal.setitimer(signal.ITIMER_REAL, seconds + _SHORTEST_S)
            function(time_s)
        except _Timeout:
            pass
        finally:
            self._called = False
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, handler)
            signal.setitimer(signal.ITIMER_REAL, *timer)
        taken_s = clock.monotonic() - self._began
        if taken_s > seconds and (taken_s := self._taken_s()) > seconds:
            told = f"a call took {1e3 * taken_s:.3g} ms, {1e3 * seconds:.3g} ms are allowed"
            raise BudgetError(told, seconds=taken_s, allowed=seconds)

    def _on_alarm(self, number: int, frame: FrameType | None) -> None:
        if not self._called:  # one more alarm would find the handler of before, and could end the process
            return
        left_s = self._seconds - self._taken_s()
        signal.setitimer(signal.ITIMER_REAL, max(left_s, 0.0) + _SHORTEST_S)
        if left_s < 0.0:
            raise _Timeout

    def _taken_s(self) -> float:
        return clock.monotonic() - self._began - (self._queued_s() - self._queued)

    def _queued_s(self) -> float:
        told = scheduled(self._pid)
        return 0.0 if told is None else told.queued_s
