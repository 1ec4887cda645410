"""Place of rest of a joint under the hardest allowed braking."""

import numpy as np
from numpy.typing import NDArray

from im_mcs.limits.braking import stopping_place
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


class Reach:
    """Upper bound of the way to rest, much cheaper than :func:`stopping_place`: needed in every tick.

    With ``r = acceleration / jerk / 2`` and ``f = v + r a`` the way is at most ``f (f / (2 acceleration) + r) +
    (v / jerk + (2 r)^2 / 3) a``. That is convex in ``v`` and in ``a``, and grows faster with each the larger the other
    is: up to the limits of both it lies below the plane through its values at rest, at the largest acceleration, and at
    the largest of both.

    Attributes:
        slopes: Way for a velocity and for an acceleration up to the limits, shape (2, n); the bound is the sum.
    """

    def __init__(self, limits: MotionLimits) -> None:
        top_v, top_a = limits.velocity * _BESIDE, limits.acceleration * _BESIDE
        r = limits.acceleration / limits.jerk / 2.0

        def bound(v: Array | float) -> Array:
            f = v + r * top_a
            return np.asarray(
                f * (f / (2.0 * limits.acceleration) + r) + (v / limits.jerk + (2.0 * r) ** 2 / 3.0) * top_a
            )

        self.slopes = np.array([(bound(top_v) - bound(0.0)) / top_v, bound(0.0) / top_a])
