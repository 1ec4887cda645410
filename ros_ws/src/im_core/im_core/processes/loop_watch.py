"""Watch of a process's loop by a thread: the agent is told about progress and treats a hang as a death."""

import math
import os
import threading
from collections.abc import Callable

from im_core.processes.loop_heartbeat import Beat, Pulse
from im_core.processes.procfs import scheduled

TICK_S = 0.5


class LoopWatch:
    """Thread checking the progress of a loop.

    It counts ticks of its own, not time: while the process is stopped, neither turns. Of a tick in which a thread of
    the process was ready to run but waited for a processor, that wait does not count: a busy computer makes late.

    Args:
        pulse: Where it tells.
        turns: How often the loop has turned; also whenever it is allowed less than before.
        nudge: Has the loop turn once, if it does; from any thread.
        allowed_s: How long it may stand still now [s].
        waited_s: How long each thread has waited for a processor so far [s], by its id.
    """

    def __init__(
        self,
        pulse: Pulse,
        turns: Callable[[], int],
        nudge: Callable[[], object],
        allowed_s: Callable[[], float],
        waited_s: Callable[[], dict[str, float]] | None = None,
    ) -> None:
        self._pulse, self._turns, self._nudge, self._allowed_s = pulse, turns, nudge, allowed_s
        self._waited_s = waited_s or waits_of_threads
        self._ticks, self._standing_s, self._seen = 0, 0.0, -1
        self._waits: dict[str, float] = {}
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="loop watch", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End; from now on nobody looks."""
        self._end.set()
        self._thread.join()
        self._pulse.beat(Beat(self._ticks, 0.0, math.inf))

    def tick(self) -> None:
        """Look once; :data:`TICK_S` have passed since the last time."""
        allowed_s = self._allowed_s()  # first: whoever is allowed less from now on has turned before
        turns = self._turns()
        if turns != self._seen:
            self._seen, self._standing_s, self._waits = turns, 0.0, {}
        else:
            waits, before = self._waited_s(), self._waits
            waited = max((wait - before[thread] for thread, wait in waits.items() if thread in before), default=0.0)
            self._waits = waits
            self._standing_s += max(0.0, TICK_S - waited)
            if self._standing_s <= TICK_S:  # once: a loop that had nothing to do turns now
                self._nudge()
        self._ticks += 1
        self._pulse.beat(Beat(self._ticks, self._standing_s, allowed_s))

    def _watch(self) -> None:
        while not self._end.wait(TICK_S):
            self.tick()


def waits_of_threads() -> dict[str, float]:
    """Return the time each thread of the process has waited for a processor so far [s]; empty without kernel data."""
    waits = {}
    for thread in os.listdir("/proc/self/task"):
        told = scheduled(os.getpid(), int(thread))
        if told is not None:
            waits[thread] = told.queued_s
    return waits
