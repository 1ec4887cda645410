"""Silence of a process that is waited for, without the time in which a busy computer gave it no processor."""

import math
from pathlib import Path

from im_core import clock

_NS = 1e-9


class Silence:
    """How long a process of this host could have answered and did not.

    A process that is dead, stopped, asleep or that computes is silent; one that wants a processor and gets none is
    not.

    Attributes:
        seconds: Silence up to the last look [s].

    Args:
        pid: Process that is waited for; its main thread is the one that answers.
        seconds: Silence so far [s].
        longest_look_s: Most that counts between two looks [s]: who did not run itself does not blame another.
    """

    def __init__(self, pid: int, seconds: float = 0.0, longest_look_s: float = math.inf) -> None:
        self.seconds = seconds
        self._proc, self._longest = Path("/proc") / str(pid), longest_look_s
        self._looked, self._times = clock.monotonic(), self._read_times()

    def look(self, counts: bool = True) -> float:
        """Count the time since the last look, and return the silence in all [s].

        Args:
            counts: Whether an answer was due in this time.
        """
        now, times = clock.monotonic(), self._read_times()
        passed = min(now - self._looked, self._longest)
        if counts:
            self.seconds += max(0.0, passed - self._starved(passed, times))
        self._looked, self._times = now, times
        return self.seconds

    def _starved(self, passed: float, times: tuple[int, int] | None) -> float:
        """For how much of the time since the last look the process wanted a processor and had none [s]."""
        if times is None or self._times is None:
            return 0.0
        (ran, queued), (ran_before, queued_before) = times, self._times
        return passed if ran == ran_before and self._wants_processor() else _NS * (queued - queued_before)

    def _read_times(self) -> tuple[int, int] | None:
        """Time on a processor and time in the queue for one [ns]; None where the kernel does not tell."""
        try:
            ran, queued, _ = (self._proc / "schedstat").read_text(encoding="ascii").split()
        except (OSError, ValueError):
            return None
        return int(ran), int(queued)

    def _wants_processor(self) -> bool:
        try:
            stat = (self._proc / "stat").read_text(encoding="ascii", errors="replace")
        except OSError:
            return False
        return stat[stat.rindex(")") + 2] == "R"
