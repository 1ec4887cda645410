"""Absolute deadlines of a real-time loop."""

from im_core import clock


class Pacer:
    """Keeper of absolute deadlines, with a count of missed ones.

    A deadline is missed if the loop comes to it more than a period late; the ticks in between are skipped, so that the
    loop does not run behind the clock for ever.

    Args:
        period_s: Wall time between ticks [s]; 0: the loop is not paced.
    """

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self.ticks = 0
        self.missed = 0
        self.missed_in_row = 0
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
        now = clock.monotonic()
        if self._deadline == 0.0:
            self._deadline = now
        late = now - self._deadline
        if late > self.period_s:
            skipped = int(late / self.period_s)
            self.missed += skipped
            self.missed_in_row += skipped
            self._deadline += skipped * self.period_s
        else:
            self.missed_in_row = 0
        self.max_lateness_s = max(self.max_lateness_s, clock.sleep_until(self._deadline))
        self._last = clock.monotonic()
        if self.ticks == 0:
            self._first = self._last
        self.ticks += 1
        self._deadline += self.period_s
