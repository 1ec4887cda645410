"""Trajectory that takes over from a motion under way: its own spline, met at once and followed within limits.

A client that plans anew many times a second waits for no re-timing: the newest trajectory begins at the next knot, from
whatever motion is there. Nothing about the way is prepared. At every knot the setpoint makes for the place of the
trajectory some moments ahead, by the shortest quintic within limits; where none is, by the quickest motion that meets
the trajectory (ruckig). What keeps limits is followed on its path and in time; jumps of acceleration are rounded, what
is beyond limits is followed later.
"""

import math
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.checks.envelope import excess
from im_mcs.planning.trajectories.follower import Ahead
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial, quintic
from im_mcs.planning.trajectories.profile import ramp, to_meet, to_rest
from im_mcs.planning.trajectories.scaling import Clock, scaled
from im_mcs.planning.trajectories.trajectory import Setpoint

# how far ahead the trajectory may be met [s]; the last one only where it goes on for ever, until a newer one comes
_MEETINGS_S = np.array([0.036, 0.072, 0.144, 0.288, 0.576])
_ROUNDS = 5
# of the rate: share of the acceleration for its changes, the largest change [1/s], and the time in which that builds up
_FORCE, _QUICKEST, _BUILD_UP_S = 0.5, 10.0, 0.1
_LEAST, _TINY = 1e-6, 1e-12
# what motion across the direction counts as none, in velocity limits
_STRAIGHT = 1e-7


class TrackedTrajectory(PiecewisePolynomial):
    """A trajectory as it came, for a group that moves already.

    Attributes:
        begin_s: Time on its own clock from which on it is tracked [s], and
        end_s: from which on the motion decelerates to rest, wherever it is; infinite: it is tracked to its end.
        streamed: Whether it is a window of a stream: its clock is the sender's, so the rate bounds velocities instead.
    """

    begin_s, end_s, streamed = 0.0, math.inf, False

    @classmethod
    def of(
        cls, asked: PiecewisePolynomial, begin_s: float = 0.0, end_s: float = math.inf, *, streamed: bool = False
    ) -> "TrackedTrajectory":
        """Return the same trajectory, to be tracked between some times on its clock [s]."""
        tracked = cls(asked.lengths, asked.coefficients, asked.points)
        tracked.begin_s, tracked.end_s, tracked.streamed = begin_s, end_s, streamed
        return tracked


class TrackingFollower:
    """Follower of a trajectory from any state.

    Attributes:
        trajectory: What is followed.
        sigma: Present time on the trajectory's own clock [s].
        rate: Rate in force.

    Args:
        start: Present setpoint.
        trajectory: What is followed.
        rate: Rate at the begin.
        limits: Of the group.
        tick_s: Servo period [s].
        divisor: Servo ticks between two evaluations.
    """

    between = None

    def __init__(
        self,
        start: Setpoint,
        trajectory: TrackedTrajectory,
        rate: float,
        limits: MotionLimits,
        tick_s: float,
        divisor: int,
    ) -> None:
        self._state, self.trajectory, self._full = start, trajectory, limits
        self._tick_s, self._divisor = tick_s, divisor
        self._bound, self._bounded = rate, False
        self._limits = self._limits_at(rate)
        rate = self._pace(rate)
        self._clock, self._t = Clock(rate, trajectory.begin_s), 0.0
        self._way = PiecewisePolynomial.standing(start.q)
        self._passed, self._last, self._over = 0.0, False, False
        self.sigma, self.rate, self._change = trajectory.begin_s, rate, 0.0

    @property
    def finished(self) -> bool:
        """Whether the trajectory has come to the end."""
        return self._arrived and (self._over or self.sigma >= self.trajectory.duration)

    @property
    def still(self) -> bool:
        """Whether nothing moves: the trajectory has ended, or is halted."""
        return self._arrived

    @property
    def end_setpoint(self) -> Setpoint:
        """Setpoint at the end, unless the motion is interrupted; that of a window once it decelerates."""
        return self._way.end_setpoint if self._over else self.trajectory.end_setpoint

    @property
    def end_known(self) -> bool:
        """Whether the place of the end is known: that of a window is not before it decelerates."""
        return self._over or math.isinf(self.trajectory.end_s)

    @property
    def progress(self) -> float:
        """Passed fraction of the trajectory's time, 0 to 1."""
        return 1.0 if self.finished else min(self.sigma / max(self.trajectory.duration, _LEAST), 1.0)

    @property
    def point(self) -> int:
        """Index of the next point of the path."""
        return self.trajectory.point(self.sigma)

    @property
    def ahead(self) -> Ahead:
        """Place that is reached in some seconds, on the way to the trajectory or on it, shape (n,)."""
        return self._ahead

    def _ahead(self, seconds: float) -> NDArray[np.float64]:
        later = self._passed + seconds
        if later < self._way.duration:
            return self._way.at(later).q
        return self.trajectory.at(self.sigma + self.rate * seconds).q

    def advance(self, rate: float) -> tuple[Setpoint, int]:
        """Return the setpoint some servo ticks ahead, and the number; ``rate`` is the wanted one from now on."""
        if rate != self._bound and not self._over:
            self._bound, self._bounded = rate, self.trajectory.streamed
            self._limits = self._limits_at(rate)
        if self._pace(rate) != self._clock.rate and not self._over:
            self._change_rate(self._pace(rate))
        if self.sigma >= self.trajectory.end_s and not self._over:
            self._way, self._passed, self._last, self._over = to_rest(self._state, self._limits), 0.0, True, True
        if not (self._arrived or self._over or (self._last and self._left() <= 0.0)):
            self._look_for_way()
        ticks = self._divisor
        if self._last and not self._arrived:
            left = (self._way.duration - self._passed) / self._tick_s
            ticks = min(max(math.ceil(left - _LEAST), 1), ticks)
        self._passed += ticks * self._tick_s
        self._t += ticks * self._tick_s
        self.sigma, self.rate, self._change = self._clock.at(self._t)
        self._state = self._way.at(self._passed)
        return self._state, ticks

    def look_ahead(self) -> None:
        """Prepare nothing: a newer trajectory may come at any time."""

    @property
    def _arrived(self) -> bool:
        """Whether the setpoint rests where the trajectory rests from now on."""
        return self._last and self._passed >= self._way.duration - _LEAST * self._tick_s

    def _pace(self, rate: float) -> float:
        """Return the rate of the clock; the clock of a stream goes on or stands."""
        return 1.0 if self.trajectory.streamed and rate > 0.0 else rate

    def _limits_at(self, rate: float) -> MotionLimits:
        if not self.trajectory.streamed or rate in (0.0, 1.0):
            return self._full
        return MotionLimits(self._full.velocity * rate, self._full.acceleration, self._full.jerk)

    def _change_rate(self, rate: float) -> None:
        """Let the clock go over to another rate, as quickly as accelerations along the trajectory allow."""
        speed = np.abs(self.trajectory.at(self.sigma).v)
        force = float((self._limits.acceleration / np.maximum(speed, _LEAST)).min())
        change = min(_FORCE * force, _QUICKEST)
        begin = min(self.sigma, self.trajectory.duration), self.rate, float(np.clip(self._change, -change, change))
        self._clock, self._t = Clock(rate, 0.0, ramp(begin, rate, change, change / _BUILD_UP_S)), 0.0
        self._last = False

    def _left(self) -> float:
        """Time until the trajectory rests for good, at its end or halted; infinite while its rate changes [s]."""
        if self._clock.rate == 0.0:
            return self._clock.ramp_s - self._t
        if self._t < self._clock.ramp_s and self.sigma < self.trajectory.duration:
            return math.inf
        return (self.trajectory.duration - self.sigma) / self._clock.rate

    def _wanted(self, seconds: float) -> Setpoint:
        """Where the trajectory is in some seconds, at speeds that limits allow."""
        sigma, rate, change = self._clock.at(self._t + seconds)
        s = scaled(self.trajectory.at(sigma), rate, change)
        fast = max(float((np.abs(s.v) / self._limits.velocity).max()), 1.0)
        strong = max(float((np.abs(s.a) / self._limits.acceleration).max()), 1.0)
        return Setpoint(s.q, s.v / fast, s.a / strong)

    def _look_for_way(self) -> None:
        """Find the way for the next moments; where no quintic keeps limits, go on as before while that leads on."""
        left, knot_s = self._left(), self._tick_s * self._divisor
        times = np.maximum(_MEETINGS_S[: -1 if math.isinf(self.trajectory.end_s) else None], 2.0 * knot_s)
        if 0.0 < left < times[-1]:
            times = np.sort(np.append(times, max(left, self._tick_s)))
        states = [s for time in times.tolist() for s in (self._state, self._wanted(time))]
        q, v, a = (np.array([getattr(state, name) for state in states]) for name in "qva")
        ways = quintic(np.repeat(times, 2)[:-1], q, v, a)[::2]
        good = np.flatnonzero(excess(ways, times, self._limits) <= 1.0)
        if good.size:
            k = int(good[0])
            self._go(PiecewisePolynomial(times[k : k + 1], ways[k : k + 1]), float(times[k]))
        elif self._bounded or not (self._last or self._passed + knot_s < self._way.duration):
            self._go(*self._quickest(float(times[0])))

    def _go(self, way: PiecewisePolynomial, seconds: float) -> None:
        self._way, self._passed, self._bounded = way, 0.0, False
        self._last = seconds >= self._left() - _LEAST

    def _quickest(self, seconds: float) -> tuple[PiecewisePolynomial, float]:
        """Return the quickest motion that meets the trajectory, and when; to rest where ruckig finds none."""
        with suppress(DataError):
            for _ in range(_ROUNDS):
                end, when = self._wanted(seconds), seconds
                way = self._to_meet(end)
                if abs(way.duration - when) <= self._tick_s:
                    break
                seconds = way.duration
            return way, when
        return to_rest(self._state, self._limits), 0.0

    def _to_meet(self, end: Setpoint) -> PiecewisePolynomial:
        """Return the quickest motion to a place with a velocity; straight if the present motion leads straight there.

        Raises:
            DataError: Ruckig finds none.
        """
        start, unit = self._state, self._limits.velocity
        rows = np.array([end.q - start.q, start.v, start.a, end.v]) / unit
        longest = rows[int((rows**2).sum(axis=1).argmax())]
        direction = longest / max(float(np.linalg.norm(longest)), _TINY)
        way, v0, a0, v1 = shares = (rows @ direction)[:, None]
        if np.abs(rows - shares * direction).max() > _STRAIGHT:
            return to_meet(start, end.q, end.v, self._limits)
        limits = MotionLimits(*(np.array([limit]) for limit in self._limits.along(direction * unit)))
        line = to_meet(Setpoint(np.zeros(1), v0, a0), way, v1, limits)
        line.coefficients = line.coefficients * (direction * unit)
        line.coefficients[:, 0] += start.q
        return PiecewisePolynomial(line.lengths, line.coefficients)
