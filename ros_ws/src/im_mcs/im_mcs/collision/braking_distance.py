"""Places of rest of joints braking from now on."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from im_mcs.limits.braking import BrakingGroup
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.model.dynamics import place_of

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
        self._reaction_s = reaction_s
        self._groups: list[BrakingGroup] = []
        for index in (*groups, *single):
            own = limits.of(index)
            place = place_of(index)
            self._groups.append(
                BrakingGroup(own.velocity, own.acceleration, own.jerk, index, place, _ALONG, reaction_s)
            )

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
            own_v, own_a = v[group.place], a[group.place]
            if curves and (ahead := curves.get(int(group.index[0]))) is not None:
                seconds = _CURVE * group.seconds_on_path(own_v, own_a) + _CURVE_S + self._reaction_s
                way[group.place] = ahead(seconds)
            elif np.count_nonzero(own_v) or np.count_nonzero(own_a):
                way[group.place] = group.displacement(own_v, own_a)
        return way
