"""Where a joint comes to rest that brakes as hard as it may."""

import math

import numpy as np
from numpy.typing import NDArray

from im_mcs.planning.motion_limits import MotionLimits

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
        ramp = limits.acceleration / limits.jerk
        self._half_ramp, self._third = ramp / 2.0, ramp**2 / 3.0
        self._square, self._per_jerk = 1.0 / (2.0 * limits.acceleration), 1.0 / limits.jerk

    def way(self, v: Array, a: Array) -> Array:
        """Bound of the way, shape (n,); magnitudes of velocity and acceleration, shape (n,) each."""
        added = self._half_ramp * a
        fastest = v + added
        return np.asarray(fastest * (self._square * fastest + self._half_ramp) + (self._per_jerk * v + self._third) * a)
