"""Place of rest of a joint under the hardest allowed braking."""

import math

import numpy as np
from numpy.typing import NDArray

from im_mcs.limits.motion_limits import MotionLimits

Array = NDArray[np.float64]

# rounding of velocities and accelerations that are at their limits
_BESIDE = 1.0 + 1e-5


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
    """Upper bound of the way to rest, much cheaper than :func:`stopping_place`: needed in every tick.

    With ``r = acceleration / jerk / 2`` and ``f = v + r a`` the way is at most ``f (f / (2 acceleration) + r) +
    (v / jerk + (2 r)^2 / 3) a``. That is convex in ``v`` and in ``a``, and grows faster with each the larger the other
    is: up to the limits of both it lies below the plane through its values at rest, at the largest acceleration, and at
    the largest of both.

    Args:
        limits: Of velocity, acceleration and jerk.
    """

    def __init__(self, limits: MotionLimits) -> None:
        top_v, top_a = limits.velocity * _BESIDE, limits.acceleration * _BESIDE
        r = limits.acceleration / limits.jerk / 2.0

        def bound(v: Array | float) -> Array:
            f = v + r * top_a
            return np.asarray(
                f * (f / (2.0 * limits.acceleration) + r) + (v / limits.jerk + (2.0 * r) ** 2 / 3.0) * top_a
            )

        self._slopes = np.array([(bound(top_v) - bound(0.0)) / top_v, bound(0.0) / top_a])

    def way(self, motion: Array) -> Array:
        """Bound of the way, shape (n,); magnitudes of velocities and accelerations up to the limits, shape (2, n)."""
        way = self._slopes * motion
        return np.asarray(way[0] + way[1])
