"""Functions at integer multiples or divisors of a base period: phase, fixed order, missed calls, statistics."""

import math
from bisect import bisect
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

from im_core import clock
from im_core.errors import FOREIGN, DataError, NotFoundError
from im_core.rate_groups.budget import Budget

#: Upper bounds of the classes of lateness [s]; a last class is beyond.
LATENESS_S = (5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2)
# Base periods of a function whose missed calls are made up; older ones are left out.
_MOST_LATE = 100
_SMOOTHING = 0.01


class Overrun(StrEnum):
    """What becomes of calls that a late loop has missed."""

    SKIP = "skip"
    """They are left out, and counted."""
    LATE = "late"
    """They are made up one after the other, those of the last 100 base periods of the function, and counted."""
    STOP = "stop"
    """The function is called no more."""


@dataclass
class RateStatistics:
    """Timing of one function.

    Attributes:
        name: Name of the function.
        every: Base periods between two calls.
        times: Calls in one base period.
        calls: Calls so far.
        missed: Calls that were due while the loop was late.
        share: Share of the base period that it takes on the average.
        mean_s: Duration of a call, smoothed over the last hundred or so [s].
        longest_s: Longest duration [s].
        lateness: Calls by lateness of the begin, in the classes of :data:`LATENESS_S`; all 0 without deadlines.
        ended: Why it is called no more; empty: it is called.
    """

    name: str
    every: int
    times: int
    calls: int = 0
    missed: int = 0
    mean_s: float = 0.0
    longest_s: float = 0.0
    share: float = 0.0
    lateness: list[int] = field(default_factory=lambda: [0] * (len(LATENESS_S) + 1))
    ended: str = ""


def rate_fault(every: int, times: int, phase: int) -> str:
    """Return why a rate is impossible, empty if it is possible; arguments as of :meth:`RateGroups.register`."""
    if every < 1 or times < 1 or (every > 1 and times > 1):
        return f"every {every}, times {times}; both are at least 1, and one of them is 1"
    return "" if 0 <= phase < every else f"phase {phase} is not from 0 to {every - 1}"


@dataclass
class _Rate:
    """A registered function; ``phase`` in base periods, ``budget_s`` None for trusted functions [s]."""

    function: Callable[[float], object]
    phase: int
    overrun: Overrun
    budget_s: float | None
    statistics: RateStatistics


class RateGroups:
    """Functions of one loop, called in the order of their registration.

    Args:
        period_s: Base period [s].

    Attributes:
        period_s: Base period [s].
        parts: Parts of the base period in which something is due: the least common multiple of all divisors.
        ended: Number of the functions that are called no more.
    """

    def __init__(self, period_s: float) -> None:
        if not 0.0 < period_s < math.inf:
            raise DataError(f"a base period of {period_s:g} s is not > 0", period=period_s)
        self.period_s, self.parts, self.ended = period_s, 1, 0
        self._rates: dict[str, _Rate] = {}
        self._budget: Budget | None = None
        self._tick: int | None = None

    def register(
        self,
        name: str,
        function: Callable[[float], object],
        *,
        every: int = 1,
        times: int = 1,
        phase: int = 0,
        overrun: Overrun = Overrun.SKIP,
        budget_s: float | None = None,
    ) -> None:
        """Register a function, behind all others.

        Args:
            name: Its name; free.
            function: Takes the time of the call on the clock of the groups [s]: base periods, late or not.
            every: Base periods between two calls, >= 1.
            times: Calls in one base period, >= 1; one of ``every`` and ``times`` is 1.
            phase: Base period of the first call, 0 to ``every`` - 1.
            overrun: What becomes of calls that a late loop has missed.
            budget_s: Most that a call may take; a call that takes longer, or raises an error, is the last one [s].
                None: it may take any time, and its errors end the loop.

        Raises:
            DataError: A value is out of range, or the name is taken.
            StateError: A budget is given in another thread than the main one.
        """
        if name in self._rates:
            raise DataError(f"a function '{name}' is registered already", name=name)
        if fault := rate_fault(every, times, phase):
            raise DataError(f"function '{name}': {fault}", name=name)
        if budget_s is not None:
            if not budget_s > 0.0:
                raise DataError(f"function '{name}': a budget of {budget_s:g} s is not > 0", name=name)
            self._budget = self._budget or Budget()
        self._rates[name] = _Rate(function, phase, overrun, budget_s, RateStatistics(name, every, times))
        self._count_parts()

    def remove(self, name: str) -> None:
        """Call a function no more.

        Raises:
            NotFoundError: None has the name.
        """
        if self._rates.pop(name, None) is None:
            raise NotFoundError(kind="function", name=name, known=list(self._rates))
        self._count_parts()

    def run(self, tick: int, part: int = 0, due_s: float | None = None) -> None:
        """Call all functions that are due in a part of a base period, and see to the missed ones.

        Args:
            tick: Number of the base period, rising; periods in between were missed.
            part: Which of its :attr:`parts`.
            due_s: When the part began by the monotonic clock [s]; None: the loop has no deadlines.
        """
        missed = range(tick if self._tick is None else self._tick + 1, tick)
        self._tick = tick
        for rate in list(self._rates.values()):
            told = rate.statistics
            if missed and not told.ended:
                self._catch_up(rate, missed)
            if not told.ended and tick % told.every == rate.phase and part * told.times % self.parts == 0:
                self._call(rate, (tick + part / self.parts) * self.period_s, due_s)

    def statistics(self) -> tuple[RateStatistics, ...]:
        """Return the timing of all functions, in their order; it goes on with the loop."""
        return tuple(rate.statistics for rate in self._rates.values())

    def _count_parts(self) -> None:
        living = (rate.statistics.times for rate in self._rates.values() if not rate.statistics.ended)
        self.parts = math.lcm(1, *living)

    def _catch_up(self, rate: _Rate, ticks: range) -> None:
        """See to the calls of missed base periods."""
        told = rate.statistics
        due = range(ticks[0] + (rate.phase - ticks[0]) % told.every, ticks.stop, told.every)
        missed = len(due) * told.times
        told.missed += missed
        if missed and rate.overrun is Overrun.STOP:
            self._end(rate, f"the loop was late: {missed} calls were missed")
        elif rate.overrun is Overrun.LATE:
            late = (
                (tick + part / told.times) * self.period_s for tick in due[-_MOST_LATE:] for part in range(told.times)
            )
            for time_s in late:
                if not told.ended:
                    self._call(rate, time_s, None)

    def _call(self, rate: _Rate, time_s: float, due_s: float | None) -> None:
        told, began = rate.statistics, clock.monotonic()
        if rate.budget_s is None:
            rate.function(time_s)
        else:
            assert self._budget is not None
            try:
                self._budget.call(rate.function, time_s, rate.budget_s)
            except FOREIGN as error:  # a function of the user's may raise anything
                self._end(rate, f"{type(error).__name__}: {error}")
        taken_s = clock.monotonic() - began
        told.calls += 1
        told.mean_s += max(_SMOOTHING, 1.0 / told.calls) * (taken_s - told.mean_s)
        told.share = told.mean_s * told.times / (told.every * self.period_s)
        told.longest_s = max(told.longest_s, taken_s)
        if due_s is not None:
            told.lateness[bisect(LATENESS_S, began - due_s)] += 1

    def _end(self, rate: _Rate, why: str) -> None:
        rate.statistics.ended = why
        self.ended += 1
        self._count_parts()
