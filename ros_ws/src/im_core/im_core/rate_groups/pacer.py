"""Absolute deadlines of a real-time loop."""

from im_core import clock


class Pacer:
    """Keeper of absolute deadlines, with a count of missed ones.

    A deadline is missed if the loop comes to it more than a period late; the ticks in between are skipped, so that the
    loop does not run behind the clock for ever.

    Attributes:
        period_s: Wall time between ticks [s].
        ticks: Ticks so far.
        skipped: Deadlines skipped by the last :meth:`wait`.
        due_s: Deadline of the current tick by the monotonic clock [s]; 0: the loop is not paced.
        missed: Missed deadlines so far.
        missed_in_row: Missed deadlines since the last one in time.
        max_lateness_s: Largest lateness so far [s].

    Args:
        period_s: Wall time between ticks [s]; 0: the loop is not paced.
    """

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self.ticks = 0
        self.missed = 0
        self.missed_in_row = 0
        self.skipped = 0
        self.due_s = 0.0
        self.max_lateness_s = 0.0
        self._first = 0.0
        self._last = 0.0
        self._deadline = 0.0

    @property
    def mean_period_s(self) -> float:
        """Mean wall time between ticks [s]; 0 while unknown or not paced."""
        if self.ticks < 2 or self.period_s == 0.0:
            return 0.0
        return (self._last - self._first) / (self.ticks - 1)

    def restart(self) -> None:
        """Count from now on."""
        self.ticks = self.missed = self.missed_in_row = 0
        self.max_lateness_s = 0.0
        self._deadline = 0.0

    def wait(self) -> None:
        """Sleep until the deadline of the current tick."""
        if self.period_s == 0.0:
            self.ticks += 1
            return
        now, self.skipped = clock.monotonic(), 0
        if self._deadline == 0.0:
            self._deadline = now
        late = now - self._deadline
        if late > self.period_s:
            self.skipped = int(late / self.period_s)
            self.missed += self.skipped
            self.missed_in_row += self.skipped
            self._deadline += self.skipped * self.period_s
        else:
            self.missed_in_row = 0
        self.max_lateness_s = max(self.max_lateness_s, clock.sleep_until(self._deadline))
        self._last, self.due_s = clock.monotonic(), self._deadline
        if self.ticks == 0:
            self._first = self._last
        self.ticks += 1
        self._deadline += self.period_s
