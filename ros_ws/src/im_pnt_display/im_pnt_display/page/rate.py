"""Limit on requests: an allowance growing at a rate."""

from collections.abc import Callable

from im_core.clock import monotonic


class Allowance:
    """Number of requests growing with time (token bucket); each request takes one away.

    Args:
        per_s: Growth [1/s].
        most: Largest number, which it begins with.
        now: Clock [s].
    """

    def __init__(self, per_s: float, most: int, now: Callable[[], float] = monotonic) -> None:
        self._per_s, self._most, self._now = per_s, most, now
        self._left, self._seen = float(most), now()

    def take_request(self) -> bool:
        """Take one away; returns whether one was left."""
        now = self._now()
        self._left = min(self._most, self._left + (now - self._seen) * self._per_s)
        self._seen = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True
