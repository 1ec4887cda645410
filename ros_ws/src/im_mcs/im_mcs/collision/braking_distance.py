"""Places of rest of joints braking from now on."""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.model.dynamics import place_of

_TINY = 1e-12
# Acceleration across the motion, as a share of its limit, that is rounding.
_ALONG = 1e-6
# A stop on a curve takes longer than one straight on, and may wait for a place where limits allow it: bounds of what
# the planner needs, as a multiple of the way straight on and a time [s].
_CURVE, _CURVE_S = 2.0, 0.2

Ahead = Callable[[float], NDArray[np.float64]]
"""Displacement of a group that its curved path brings within some seconds, shape (k,)."""
STRAIGHT: Mapping[int, Ahead] = {}


class BrakingDistance:
    """Displacement of every joint until rest, when each group brakes on the path.

    Alone, a joint first takes its acceleration to zero, then decelerates, both within the limits of acceleration and
    jerk. A group that brakes on its path keeps its joints in proportion: it decelerates like one joint whose limits
    are the tightest of all, each divided by the speed of its joint. The larger displacement counts. On a curve it is
    that of the path itself, as far on as a stop may take.

    Args:
        limits: Of all joints, each of shape (n,).
        groups: Joints that brake together; a joint of no group brakes alone.
        reaction_s: Time in which the motion goes on before it brakes [s].
    """

    def __init__(self, limits: MotionLimits, groups: Sequence[NDArray[np.intp]], reaction_s: float) -> None:
        grouped = {int(joint) for index in groups for joint in index}
        single = [np.array([joint]) for joint in range(len(limits.velocity)) if joint not in grouped]
        self._groups = [_Group(limits.of(index), index, reaction_s) for index in (*groups, *single)]

    def displacement(
        self, v: NDArray[np.float64], a: NDArray[np.float64], curves: Mapping[int, Ahead] = STRAIGHT
    ) -> NDArray[np.float64]:
        """Way of every joint until rest, shape (n,) [rad or m].

        Args:
            v: Velocities, shape (n,) [rad/s or m/s].
            a: Accelerations, shape (n,) [rad/s2 or m/s2].
            curves: Groups on curved paths, by their first joint.
        """
        way = np.zeros(len(v))
        for group in self._groups:
            index = group.index
            own_v, own_a = v[index], a[index]
            if curves and (ahead := curves.get(int(index[0]))) is not None:
                way[group.place] = ahead(group.seconds_on_curve(own_v, own_a))
            elif np.count_nonzero(own_v) or np.count_nonzero(own_a):
                way[group.place] = group.displacement(own_v, own_a)
        return way


class _Group:
    """Joints braking together."""

    def __init__(self, limits: MotionLimits, index: NDArray[np.intp], reaction_s: float) -> None:
        self.index, self.place = index, place_of(index)
        self._acceleration, self._jerk = limits.acceleration, limits.jerk
        self._inverse = 1.0 / np.stack([limits.acceleration, limits.jerk])
        self._weight = limits.velocity**-2.0
        self._across = _ALONG * limits.acceleration
        self._reaction = reaction_s

    def displacement(self, v: NDArray[np.float64], a: NDArray[np.float64]) -> NDArray[np.float64]:
        """Way until rest, shape (k,); not all of ``v`` and ``a`` are zero."""
        forward = self._forward(v, a)
        if 0 in (np.abs(a - forward * v) <= self._across).tobytes():
            return self._apart(v, a)
        # straight on: in proportion, no joint needs more way alone than together with the others
        gain = 1.0 + self._reaction * forward
        if abs(gain) < 1.0:
            gain = 1.0
        return v * (gain * (self._seconds(v, forward / gain, gain) + self._reaction))

    def seconds_on_curve(self, v: NDArray[np.float64], a: NDArray[np.float64]) -> float:
        """Return the largest time along the path up to the end of a stop."""
        return _CURVE * self._seconds(v, self._forward(v, a)) + _CURVE_S + self._reaction

    def _apart(self, v: NDArray[np.float64], a: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return joints with accelerations off the motion: each alone, and together."""
        later = v + self._reaction * a
        v = np.where(np.abs(later) > np.abs(v), later, v)  # a motion that speeds up does so until it brakes
        shared = self._seconds(v, self._forward(v, a))
        given = zip(v.tolist(), a.tolist(), self._acceleration.tolist(), self._jerk.tolist(), strict=True)
        alone = [_to_rest(abs(v), math.copysign(a, a * v), most, jerk) for v, a, most, jerk in given]
        size = np.abs(v)
        return np.asarray(np.sign(v) * (np.maximum(alone, shared * size) + self._reaction * size))

    def _forward(self, v: NDArray[np.float64], a: NDArray[np.float64]) -> float:
        """Acceleration along the motion, as a multiple of the velocities."""
        weighted = self._weight * v
        return float(weighted.dot(a)) / max(float(weighted.dot(v)), _TINY)

    def _seconds(self, v: NDArray[np.float64], forward: float, gain: float = 1.0) -> float:
        """Way until rest of the joints together, in seconds at ``gain`` times the velocities ``v``."""
        acceleration, jerk = np.maximum.reduce(self._inverse * np.abs(v), axis=1).tolist()
        return _to_rest(1.0, forward, 1.0 / max(gain * acceleration, _TINY), 1.0 / max(gain * jerk, _TINY))


def _to_rest(speed: float, forward: float, most: float, jerk: float) -> float:
    """Way of a joint until rest, alone.

    Args:
        speed: >= 0.
        forward: Acceleration in the direction of the motion.
        most: Limit of acceleration.
        jerk: Limit of jerk.
    """
    # the profile from constant velocity `peak` that passes through the present state
    if forward >= 0.0:
        t = forward / jerk
        peak = speed + 0.5 * forward * t
        passed = -t * (speed + forward * t / 3.0)
    else:
        forward = min(-forward, math.sqrt(2.0 * jerk * speed))
        t = forward / jerk
        peak = speed + 0.5 * forward * t
        passed = t * (peak - forward * t / 6.0)
    ramp = most / jerk
    way = peak * (math.sqrt(peak / jerk) if peak < most * ramp else 0.5 * (peak / most + ramp))
    return way - passed
