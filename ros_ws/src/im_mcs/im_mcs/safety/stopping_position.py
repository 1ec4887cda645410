"""Where a joint comes to rest that brakes as hard as it may."""

import math

import numpy as np
from numpy.typing import NDArray

from im_mcs.limits.motion_limits import MotionLimits

Array = NDArray[np.float64]


def stopping_position(q: Array, v: Array, a: Array, limits: MotionLimits) -> Array:
    """Positions of rest after the shortest jerk-limited braking, shape (n,) [rad or m].

    Args:
        q: Positions, shape (n,) [rad or m].
        v: Velocities.
        a: Accelerations.
        limits: Of acceleration and jerk.
    """
    given = zip(*(x.tolist() for x in (q, v, a, limits.acceleration, limits.jerk)), strict=True)
    return np.array([stopping_place(*joint) for joint in given])


def stopping_place(q: float, v: float, a: float, most: float, jerk: float) -> float:
    """Position of rest of one joint after the shortest jerk-limited braking [rad or m].

    First the acceleration is brought to zero, then velocity, each with jerk and acceleration at their limits. A joint
    that brakes already is taken back to where its braking began.

    Args:
        q: Position [rad or m].
        v: Velocity.
        a: Acceleration.
        most: Limit of acceleration.
        jerk: Limit of jerk.
    """
    ramp = abs(a) / jerk
    gain = a * ramp / 2.0
    coasting = v + gain
    if coasting * a < 0.0:
        began = abs(v - gain)
        braked = began * ramp - jerk * ramp**3 / 6.0
        return q + math.copysign(_distance(began, most, jerk) - braked, v)
    return q + v * ramp + a * ramp**2 / 3.0 + math.copysign(_distance(abs(coasting), most, jerk), coasting)


def _distance(speed: float, most: float, jerk: float) -> float:
    """Way from a speed >= 0 without acceleration to rest."""
    if speed < most**2 / jerk:
        return speed * math.sqrt(speed / jerk)
    return speed**2 / (2.0 * most) + speed * most / (2.0 * jerk)


class Reach:
    """An upper bound of the way to rest that is cheaper than :func:`stopping_place`.

    Args:
        limits: Of acceleration and jerk.
    """

    def __init__(self, limits: MotionLimits) -> None:
        # f * (s * f + r) + (v / jerk + (2 r)^2 / 3) * a with f = v + r * a, multiplied out: this is asked in every tick
        r, s = limits.acceleration / limits.jerk / 2.0, 1.0 / (2.0 * limits.acceleration)
        self._squares = np.array([s, s * r**2])
        self._singles = np.array([r, r**2 + (2.0 * r) ** 2 / 3.0])
        self._product = 2.0 * s * r + 1.0 / limits.jerk

    def way(self, motion: Array) -> Array:
        """Bound of the way, shape (n,); magnitudes of velocities and accelerations, shape (2, n)."""
        way = self._squares * motion
        way += self._singles
        way[0] += self._product * motion[1]
        way *= motion
        return np.asarray(way[0] + way[1])
