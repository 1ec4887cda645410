"""Time scaling: change of the speed along a trajectory, without leaving the path.

The place on the trajectory is its own time ``sigma``; the *rate* ``r = d sigma / dt`` is 1 as planned, 0 at a pause:

    q(sigma),  v = q' r,  a = q'' r^2 + q' r'

(J.E. Bobrow, S. Dubowsky, J.S. Gibson, "Time-optimal control of robotic manipulators along specified paths", 1985).
Every change of rate is a jerk-limited ramp. The quickest is taken whose motion, computed beforehand at every instant at
which it will be evaluated, keeps the limits of every joint.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial
from im_mcs.planning.trajectories.profile import ramp
from im_mcs.planning.trajectories.trajectory import Setpoint, Trajectory

# Ramps that are tried: change of rate and its change, as shares of what limits allow on a straight path at constant
# speed. Where one of the two limits is used up by the trajectory itself, the other need not be low.
# The gentlest need no more than the reserve, whatever the trajectory uses.
_PACES = tuple(
    (p, s) for p in (1.25, 0.9, 0.65, 0.45, 0.3, 0.15, 0.07, 0.03, 0.015) for s in (1.25, 0.8, 0.45, 0.3, 0.15, 0.03)
)
_TRIES_AGAIN = 5
_QUICK = 2.0
_FALL = 0.5
# what is left between planning limits and those of the cell, and how long a stop waits for a ramp that needs none of it
_RESERVE = 0.05
_WAIT_S = 0.25
# rounding, and what lies between the instants that are looked at
_TOLERANCE = 5e-4
_LOOK_AHEAD_S = 0.3
_SAMPLES = 64
_BESIDE_S = 1e-6


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
        """Return ``sigma``, rate and change of rate at time ``t`` [s]."""
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


def scaled(s: Setpoint, rate: float | NDArray[np.float64], change: float | NDArray[np.float64]) -> Setpoint:
    """Return the motion of a trajectory's state ``s`` at a changing rate; of m states, with both of shape (m, 1)."""
    return Setpoint(s.q, s.v * rate, s.a * (rate * rate) + s.v * change)


def least_rate(v: NDArray[np.float64], a: NDArray[np.float64], limits: MotionLimits) -> float:
    """Return the smallest rate of a trajectory from a motion ``v``, ``a`` within limits in the trajectory's time."""
    speed = float((np.abs(v) / limits.velocity).max())
    force = float(np.sqrt(np.abs(a) / limits.acceleration).max())
    return min(max(speed, force), 1.0)


class RateGovernor:
    """Search for changes of rate within the limits.

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
        """Return a clock with a change to ``rate``, or None: not now, ask again.

        To come to a stop, or to leave one, a clock is found always: where no ramp keeps the limits (a trajectory that
        uses them up itself) and the trajectory does not slow down of its own, one that keeps those of the cell, after
        a short wait for a better one.

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
        longest = _QUICK * ways[0][0]
        if rate == 0.0 and waited_s < _WAIT_S:
            ways = [way for way in ways if way[0] <= longest]  # a stop waits a little for a quick ramp
        tried: dict[int, tuple[float, Clock]] = {}

        def judge(k: int) -> float:
            _, p, s = ways[k]
            clock = Clock(rate, sigma, ramp(state, rate, p * acceleration, s * jerk))
            tried[k] = self._excess(trajectory, clock), clock
            return tried[k][0]

        found = self._quickest(len(ways), judge) if waited_s == 0.0 else self._next(len(ways), judge, waited_s)
        if found is not None:
            # a trajectory that slows down as fast as it can is left to it, until a ramp is quick
            return None if falling and ways[found][0] > longest else tried[found][1]
        least, clock = min(tried.values(), key=lambda each: each[0])
        must = (rate == 0.0 or state[1] == 0.0) and not falling and waited_s >= _WAIT_S
        return clock if must and least <= _RESERVE else None

    @staticmethod
    def _quickest(count: int, judge: Callable[[int], float]) -> int | None:
        """Return the quickest ramp within the limits, assuming slower ramps keep any limit kept by quicker ones."""
        too_quick, slow = -1, count
        while slow - too_quick > 1:
            k = (too_quick + slow) // 2
            too_quick, slow = (too_quick, k) if judge(k) <= _TOLERANCE else (k, slow)
        return slow if slow < count else None

    def _next(self, count: int, judge: Callable[[int], float], waited_s: float) -> int | None:
        """Return the quickest of a few ramps, others each time, so all ramps have a turn."""
        step = max(count // _TRIES_AGAIN, 1)
        some = range(round(waited_s / self._period) % step, count, step)
        return next((k for k in some if judge(k) <= _TOLERANCE), None)

    @staticmethod
    def _estimate(change: float, acceleration: float, jerk: float) -> float:
        """How long a ramp takes from no change of rate to none [s]."""
        if change * jerk < acceleration**2:
            return 2.0 * math.sqrt(change / jerk)
        return change / acceleration + acceleration / jerk

    def _excess(self, trajectory: Trajectory, clock: Clock) -> float:
        """Return the excess of a clock's ramp as a share of the limits; infinite for a motion going back.

        What the trajectory does by itself is no fault of the ramp: it does so at any rate.
        """
        t = self._instants(trajectory, clock)
        sigma, rate, change = (x[:, None] for x in clock.span(t))
        if rate.min() < -1e-9:
            return np.inf
        s = trajectory.span(sigma[:, 0])
        own_force, own_jerk = s.a * rate**2, trajectory.jerk(sigma[:, 0]) * rate**3
        jerk = own_jerk + 3.0 * s.a * rate * change
        if clock.change is not None:
            jerk += s.v * clock.change.jerk(t)
        limits = self._limits
        speed = (np.abs(s.v) * rate / limits.velocity).max()
        force = (np.abs(own_force + s.v * change) / np.maximum(limits.acceleration, np.abs(own_force))).max()
        jolt = (np.abs(jerk) / np.maximum(limits.jerk, np.abs(own_jerk))).max()
        return float(max(speed, force, jolt) - 1.0)

    @staticmethod
    def _instants(trajectory: Trajectory, clock: Clock) -> NDArray[np.float64]:
        """Return the checked times of a ramp, shape (m,): close to each other, and on both sides of piece borders.

        Of a trajectory whose pieces are shorter than the steps, these do for its pieces.
        """
        t = np.linspace(0.0, clock.ramp_s, _SAMPLES)
        sigma = clock.span(t)[0]
        inner = trajectory.edges[(trajectory.edges > sigma[0]) & (trajectory.edges < sigma[-1])]
        met = [np.interp(inner, sigma, t)] if inner.size < _SAMPLES else []
        if clock.change is not None:
            met.append(clock.change.edges[1:])
        sides = [edges + side for edges in met for side in (-_BESIDE_S, _BESIDE_S)]
        return np.asarray(np.clip(np.concatenate([t, *sides]), 0.0, clock.ramp_s))
