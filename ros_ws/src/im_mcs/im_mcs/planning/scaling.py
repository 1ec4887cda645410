"""Time scaling: how fast a trajectory is run through, changed without leaving its path.

The place on the trajectory is its own time ``sigma``; the *rate* ``r = d sigma / dt`` is 1 as planned, 0 at a pause:

    q(sigma),  v = q' r,  a = q'' r^2 + q' r'

(J.E. Bobrow, S. Dubowsky, J.S. Gibson, "Time-optimal control of robotic manipulators along specified paths", 1985).
Every change of rate is a jerk-limited ramp. The quickest is taken whose motion, computed beforehand at every instant at
which it will be evaluated, keeps the limits of every joint.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.polynomial import PiecewisePolynomial
from im_mcs.planning.profile import ramp
from im_mcs.planning.trajectory import Setpoint, Trajectory

# Ramps that are tried: change of rate and its change, as shares of what limits allow on a straight path at constant
# speed. Where one of the two limits is used up by the trajectory itself, the other need not be low.
_PACES = tuple((p, s) for p in (1.25, 0.9, 0.65, 0.45, 0.3, 0.15, 0.07) for s in (1.25, 0.8, 0.45, 0.3, 0.15))
_TRIES, _TRIES_AGAIN = 15, 5
_QUICK = 2.0
_FALL = 0.5
# what is left between planning limits and those of the cell, and how long a stop waits for a ramp within it
_RESERVE = 0.05
_WAIT_S = 0.25
# what averages over an instant and interpolation between instants may differ by
_TOLERANCE = 0.02
_LOOK_AHEAD_S = 0.3
_MOST_SAMPLES = 120


@dataclass(frozen=True)
class Clock:
    """Place on a trajectory, as a function of time.

    Args:
        change: The ramp in ``sigma``, one joint; its end does not count as a stop.
        rate: Rate from the ramp's end on.
        start: Place where a clock without a ramp begins.
    """

    rate: float
    start: float = 0.0
    change: PiecewisePolynomial | None = None

    @property
    def ramp_s(self) -> float:
        """Duration of the change of rate [s]."""
        return self.change.duration if self.change is not None else 0.0

    def at(self, t: float) -> tuple[float, float, float]:
        """``sigma``, rate and change of rate at time ``t`` [s]."""
        if self.change is None:
            return self.start + self.rate * t, self.rate, 0.0
        if t >= self.change.duration:
            return float(self.change.end_setpoint.q[0]) + self.rate * (t - self.change.duration), self.rate, 0.0
        s = self.change.at(t)
        return float(s.q[0]), float(s.v[0]), float(s.a[0])

    def span(self, t: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """The same at many times, shape (m,)."""
        if self.change is None:
            return self.start + self.rate * t, np.full_like(t, self.rate), np.zeros_like(t)
        s, after = self.change.span(t), t >= self.change.duration
        sigma, rate = s.q[:, 0], s.v[:, 0]
        sigma[after] += self.rate * (t[after] - self.change.duration)
        rate[after] = self.rate
        return sigma, rate, s.a[:, 0]


def scaled(s: Setpoint, rate: float, change: float) -> Setpoint:
    """Motion of a trajectory's state ``s`` at a rate that changes."""
    if rate == 1.0 and change == 0.0:
        return s
    return Setpoint(s.q, s.v * rate, s.a * (rate * rate) + s.v * change)


def least_rate(v: NDArray[np.float64], a: NDArray[np.float64], limits: MotionLimits) -> float:
    """Smallest rate at which a trajectory that begins with a motion ``v``, ``a`` can keep limits in its own time."""
    speed = float((np.abs(v) / limits.velocity).max())
    force = float(np.sqrt(np.abs(a) / limits.acceleration).max())
    return min(max(speed, force), 1.0)


class RateGovernor:
    """Finds changes of rate that keep the limits.

    Args:
        limits: Of the group.
        period_s: Time between two evaluations of the trajectory [s].
    """

    def __init__(self, limits: MotionLimits, period_s: float) -> None:
        self._limits = limits
        self._period = period_s

    def change(
        self, trajectory: Trajectory, state: tuple[float, float, float], rate: float, waited_s: float
    ) -> Clock | None:
        """A clock that goes over to ``rate``, or None: not now, ask again.

        To come to a stop, or to leave one, a clock is found always: where no ramp keeps the limits (a trajectory that
        uses them up itself) and the trajectory does not slow down of its own, the ramp that goes beyond them least,
        after a short wait for a better one.

        Args:
            trajectory: What is followed.
            state: Place, rate and change of rate now.
            rate: To go over to, 0 to 1.
            waited_s: For how long it has been tried in vain; then only some of the ramps are looked at [s].
        """
        sigma = state[0]
        ahead = trajectory.span(sigma + np.linspace(0.0, _LOOK_AHEAD_S, 16) * max(state[1], rate))
        usable = np.abs(ahead.v).max(axis=0)
        if not usable.any():
            return Clock(rate, sigma)
        if not ahead.v[0].any() and not ahead.a[0].any() and state[2] == 0.0:
            return Clock(rate, sigma)
        speed = (ahead.v**2).sum(axis=1)
        falling = state[1] > 0.0 and bool(speed[1] < speed[0] or speed.min() < _FALL * speed[0])
        with np.errstate(divide="ignore"):
            acceleration = float((self._limits.acceleration / usable).min())
            jerk = float((self._limits.jerk / usable).min())
        ways = sorted((self._estimate(abs(rate - state[1]), p * acceleration, s * jerk), p, s) for p, s in _PACES)
        best: tuple[float, Clock] | None = None
        for seconds, p, s in self._some(ways, waited_s):
            slow = seconds > _QUICK * ways[0][0]
            if slow and rate == 0.0 and waited_s < _WAIT_S:
                break  # a stop waits a little for a quick ramp
            clock = Clock(rate, sigma, ramp(state, rate, p * acceleration, s * jerk))
            excess = self._excess(trajectory, clock)
            if excess <= _TOLERANCE:
                # a trajectory that slows down as fast as it can is left to it, until a ramp is quick
                return None if falling and slow else clock
            if np.isfinite(excess) and (best is None or excess < best[0]):
                best = excess, clock
        if best is None or falling:
            return None
        must = rate == 0.0 or state[1] == 0.0
        return best[1] if must and (best[0] <= _RESERVE or waited_s >= _WAIT_S) else None

    def _some(
        self, ways: Sequence[tuple[float, float, float]], waited_s: float
    ) -> Sequence[tuple[float, float, float]]:
        """Ramps to try now: many at first, then a few others each time, so that all of them have their turn."""
        if waited_s == 0.0:
            return ways[:: len(ways) // _TRIES]
        step = len(ways) // _TRIES_AGAIN
        return ways[round(waited_s / self._period) % step :: step]

    @staticmethod
    def _estimate(change: float, acceleration: float, jerk: float) -> float:
        """How long a ramp takes from no change of rate to none [s]."""
        if change * jerk < acceleration**2:
            return 2.0 * math.sqrt(change / jerk)
        return change / acceleration + acceleration / jerk

    def _excess(self, trajectory: Trajectory, clock: Clock) -> float:
        """How far the motion of a clock's ramp goes beyond limits, as a share of them; infinite if it goes back."""
        step = max(self._period, clock.ramp_s / _MOST_SAMPLES)
        t = np.asarray(np.arange(int(clock.ramp_s / step) + 3) * step, dtype=np.float64)
        sigma, rate, change = clock.span(t)
        if rate.min() < -1e-9:
            return np.inf
        s = trajectory.span(sigma)
        squared = (rate * rate)[:, None]
        own = s.a * squared
        a = own + s.v * change[:, None]
        jerk = np.abs(np.diff(a, axis=0)) / step
        # a trajectory with jumps of acceleration (a cubic spline) has them at any rate
        given = np.abs(np.diff(s.a, axis=0)) * np.maximum(squared[1:], squared[:-1]) / step
        limits = self._limits
        speed = (np.abs(s.v) * rate[:, None] / limits.velocity).max() - 1.0
        force = (np.abs(a) / np.maximum(limits.acceleration, np.abs(own))).max() - 1.0
        jolt = (jerk / np.maximum(limits.jerk, given)).max() - 1.0
        # velocity has less to do with averaging than the others: a tenth of their tolerance
        return float(max(10.0 * speed, force, jolt))
