"""Follower of a trajectory, at a changeable rate."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial
from im_mcs.planning.trajectories.scaling import Clock, RateGovernor, scaled
from im_mcs.planning.trajectories.straight_stop import brake_straight, is_straight
from im_mcs.planning.trajectories.trajectory import Setpoint, Trajectory

_LEAST = 1e-6
# Path ahead whose direction is judged at once, anew when half of it has passed: stops end within the other half [s].
_JUDGED_S = 3.0
# While a ramp has longer than this to go [s], one is sought at each knot that takes this share of it.
_LONG_S, _QUICKER = 0.4, 0.8
# At a rate that stays, the setpoints before so many knots are evaluated at once: it takes little longer than one.
_KNOTS = 8

Ahead = Callable[[float], NDArray[np.float64]]
"""Place on a curved path that is reached in some seconds, if nothing changes, shape (n,)."""


class _Knot(NamedTuple):
    """Where a clock leads from one knot to the next.

    Attributes:
        clock: The clock, and
        since: its time at the knot before [s].
        ticks: Servo ticks from there.
        t: Time of the clock at the knot [s].
        sigma: Place on the trajectory, in its own time [s], with
        rate: rate and
        rate_change: change of rate.
        between: Setpoints of the ticks between, shape (ticks - 1, n) each.
        setpoint: That of the knot.
    """

    clock: Clock
    since: float
    ticks: int
    t: float
    sigma: float
    rate: float
    rate_change: float
    between: Setpoint | None
    setpoint: Setpoint


class PathFollower:
    """One trajectory being followed.

    Attributes:
        trajectory: What is followed.
        between: Setpoints of the ticks between the last knot and the one before it, shape (ticks - 1, n) each: a
            quintic through both knots would pass the limit of jerk where that of the motion jumps.

    Args:
        trajectory: Begins at the present setpoint, as seen at ``rate``.
        rate: Rate at the begin.
        limits: Of the group.
        tick_s: Servo period [s].
        divisor: Servo ticks between two evaluations.
    """

    def __init__(self, trajectory: Trajectory, rate: float, limits: MotionLimits, tick_s: float, divisor: int) -> None:
        self.trajectory = trajectory
        self._clock = Clock(rate)
        self._t = 0.0
        self._tick_s, self._divisor = tick_s, divisor
        self._governor = RateGovernor(limits, tick_s * divisor)
        self._limits = limits
        self._refused: float | None = None
        self._waited_s = 0.0
        self._now: Setpoint | None = None
        self._brake: tuple[PiecewisePolynomial, float] | None = None
        self.sigma, self.rate, self.rate_change = 0.0, rate, 0.0
        self.between: Setpoint | None = None
        self._rate_before = rate
        self._judged, self._straight = -math.inf, True
        self._ready_clock: Clock | None = None
        self._ready: list[Setpoint] = []
        self._next: _Knot | None = None

    @property
    def finished(self) -> bool:
        """Whether the trajectory has come to the end."""
        return self.sigma >= self.trajectory.duration

    @property
    def still(self) -> bool:
        """Whether nothing moves: the trajectory has ended, or is halted."""
        return self.finished or (self.rate == 0.0 and self.rate_change == 0.0)

    @property
    def end_setpoint(self) -> Setpoint:
        """Setpoint at the end, unless the motion is interrupted."""
        return self.trajectory.at(self.trajectory.duration)

    @property
    def progress(self) -> float:
        """Passed fraction of the trajectory's time, 0 to 1."""
        if self.trajectory.duration == 0.0:
            return 1.0
        return min(self.sigma / self.trajectory.duration, 1.0)

    @property
    def point(self) -> int:
        """Index of the next point of the path."""
        return self.trajectory.point(self.sigma)

    def advance(self, rate: float) -> tuple[Setpoint, int]:
        """Return the setpoint some servo ticks ahead, and the number; ``rate`` is the wanted one from now on."""
        self.between = None
        if self._brake is not None:
            return self._braked(*self._brake)
        if rate != self._clock.rate:
            self._change(rate)
            if self._brake is not None:
                return self._braked(*self._brake)
        elif self._clock.ramp_s - self._t > _LONG_S:
            self._hasten()
        knot = self._next_knot()
        self._t, self.sigma, self.rate, self.rate_change = knot.t, knot.sigma, knot.rate, knot.rate_change
        self.between, self._now = knot.between, knot.setpoint
        return knot.setpoint, knot.ticks

    @property
    def plan(self) -> tuple[object, object]:
        """Objects that stay the same as long as the motion goes on as planned."""
        return self._clock, self._brake

    @property
    def left_s(self) -> float:
        """Time from the last knot until the motion rests, if nothing changes [s]."""
        if self._brake is not None:
            return max(self._brake[0].duration - self._t, 0.0)
        ramp_s = max(self._clock.ramp_s - self._t, 0.0)
        sigma = self._clock.at(self._t + ramp_s)[0]
        if self._clock.rate == 0.0:
            return ramp_s
        return ramp_s + max(self.trajectory.duration - sigma, 0.0) / self._clock.rate

    def course(self, t: NDArray[np.float64]) -> Setpoint:
        """Return the setpoints at times after the last knot, shape (m,) [s], if nothing changes: shape (m, n) each."""
        if self._brake is not None:
            return self._brake[0].span(np.minimum(self._t + t, self._brake[0].duration))
        sigma, rate, change = self._clock.span(self._t + t)
        s = self.trajectory.span(np.minimum(sigma, self.trajectory.duration))
        return scaled(s, rate[:, None], change[:, None])

    def look_ahead(self) -> None:
        """Evaluate the knot to which :meth:`advance` comes next, unless the rate changes."""
        if self._brake is None and not self.finished:
            self._next_knot()

    def _next_knot(self) -> _Knot:
        """The knot to which the clock leads from here; evaluated once."""
        if self._next is None or self._next.clock is not self._clock or self._next.since != self._t:
            self._next = self._evaluated()
        return self._next

    def _evaluated(self) -> _Knot:
        ticks, steady = self._divisor, self._t >= self._clock.ramp_s
        if self.rate > _LEAST and steady:
            left = (self.trajectory.duration - self.sigma) / (self.rate * self._tick_s)
            ticks = min(max(math.ceil(left - _LEAST), 1), ticks)
        between = None
        if ticks > 1 and (not steady or self._clock.rate > 0.0):
            many = steady and ticks == self._divisor
            between = self._next_between() if many else self._between([self._t], ticks)
        t = self._t + ticks * self._tick_s
        sigma, rate, rate_change = self._clock.at(t)
        if sigma >= self.trajectory.duration - _LEAST * self._tick_s:
            sigma = self.trajectory.duration
        setpoint = scaled(self.trajectory.at(sigma), rate, rate_change)
        return _Knot(self._clock, self._t, ticks, t, sigma, rate, rate_change, between, setpoint)

    @property
    def ahead(self) -> Ahead | None:
        """Direction of a curved path; None for a path straight for longer than any stop takes."""
        if self.sigma >= self._judged + _JUDGED_S / 2.0:
            self._judged = self.sigma
            self._straight = is_straight(self.trajectory, self.sigma, self.sigma + _JUDGED_S)
        return None if self._straight else self._ahead

    def _ahead(self, seconds: float) -> NDArray[np.float64]:
        end = self.sigma + self.rate * seconds if self._brake is None else self._brake[1]
        return self.trajectory.at(end).q

    def _braked(self, brake: PiecewisePolynomial, end: float) -> tuple[Setpoint, int]:
        """Brake on a straight stretch; a later rate counts from the place of rest."""
        left = (brake.duration - self._t) / self._tick_s
        ticks = min(max(math.ceil(left - _LEAST), 1), self._divisor)
        if ticks > 1:
            self.between = brake.span(self._t + self._later(ticks))
        self._t += ticks * self._tick_s
        share = min(self._t / brake.duration, 1.0)
        self.rate, self.rate_change = self._rate_before * (1.0 - share), 0.0
        if share == 1.0:
            self._brake, self._clock, self._t = None, Clock(0.0, end), 0.0
            self.sigma, self.rate = end, 0.0
            self._now = Setpoint.at_rest(self.trajectory.at(end).q)
        else:
            self._now = brake.at(self._t)
        return self._now, ticks

    def _next_between(self) -> Setpoint:
        """Return the setpoints before the next knot, at a constant rate: several knots are evaluated at once."""
        if self._ready_clock is not self._clock or not self._ready:
            knots, rows = [self._t], self._divisor - 1
            for _ in range(_KNOTS - 1):
                knots.append(knots[-1] + self._divisor * self._tick_s)
            s = self._between(knots, self._divisor)
            self._ready_clock = self._clock
            self._ready = [Setpoint(s.q[k : k + rows], s.v[k : k + rows], s.a[k : k + rows]) for k in _ranks(rows)]
        return self._ready.pop()

    def _between(self, knots: list[float], ticks: int) -> Setpoint:
        """Return setpoints of the ticks between some knots and the next ones, shape (len(knots) * (ticks - 1), n)."""
        t = (np.array(knots)[:, None] + self._later(ticks)).ravel()
        sigma, rate, change = self._clock.span(t)
        s = self.trajectory.span(np.minimum(sigma, self.trajectory.duration))
        return scaled(s, rate[:, None], change[:, None])

    def _later(self, ticks: int) -> NDArray[np.float64]:
        """Return times of the ticks before the next knot, from now, shape (ticks - 1,) [s]."""
        return np.asarray(np.arange(1, ticks) * self._tick_s, dtype=np.float64)

    def _change(self, rate: float) -> None:
        if rate == 0.0 and self._now is not None:
            self._brake = brake_straight(self.trajectory, self.sigma, self._now, self._limits)
            if self._brake is not None:
                self._t, self._rate_before = 0.0, self.rate
                return
        state = self.sigma, self.rate, self.rate_change
        self._waited_s = self._waited_s + self._divisor * self._tick_s if self._refused == rate else 0.0
        clock = self._governor.change(self.trajectory, state, rate, self._waited_s)
        self._refused = rate if clock is None else None
        if clock is not None:
            self._clock, self._t = clock, 0.0
            self.rate, self.rate_change = clock.at(0.0)[1:]

    def _hasten(self) -> None:
        """Change to a quicker ramp: the slower the present motion, the more the limits leave for the change."""
        self._waited_s += self._divisor * self._tick_s
        state = self.sigma, self.rate, self.rate_change
        clock = self._governor.change(self.trajectory, state, self._clock.rate, self._waited_s)
        if clock is not None and clock.ramp_s < _QUICKER * (self._clock.ramp_s - self._t):
            self._clock, self._t = clock, 0.0


class Standing:
    """Standing still at one place; the simplest follower."""

    finished = still = True
    progress, point, sigma = 1.0, 0, 0.0
    rate = 1.0
    ahead = None
    between = None
    trajectory = None
    left_s = 0.0

    def __init__(self, q: NDArray[np.float64]) -> None:
        self.end_setpoint = Setpoint.at_rest(q)

    @property
    def plan(self) -> tuple[object, object]:
        """The place."""
        return self.end_setpoint, None

    def course(self, t: NDArray[np.float64]) -> Setpoint:
        """Return the place at times, shape (m,): shape (m, n)."""
        return Setpoint.at_rest(np.tile(self.end_setpoint.q, (len(t), 1)))

    def look_ahead(self) -> None:
        """There is nothing to prepare."""

    def advance(self, rate: float) -> tuple[Setpoint, int]:
        """Return the same setpoint, for any rate."""
        return self.end_setpoint, 1


def _ranks(rows: int) -> range:
    """Where the rows of each knot begin, the last knot first."""
    return range((_KNOTS - 1) * rows, -1, -rows)
