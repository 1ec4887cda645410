"""Watches of the motion: speed, following error, distances."""

import numpy as np

from im_mcs.limits import JointLimits
from im_mcs.safety.watch import Finding, Reaction, Situation

_ESTOP_FACTOR = 2.0


class SpeedWatch:
    """A joint is faster than any motion commands.

    Args:
        limits: Limits of all joints.
    """

    def __init__(self, limits: JointLimits) -> None:
        self._limits = limits

    def check(self, now: Situation) -> Finding | None:
        """What no controller can mend is an e-stop."""
        fault = self._limits.overspeed(now.v)
        return None if fault is None else Finding(Reaction.ESTOP, fault)


class FollowingWatch:
    """A joint is too far off its setpoint: a protective stop; twice as far: an e-stop.

    Args:
        limits: Bounds of the following error.
    """

    def __init__(self, limits: JointLimits) -> None:
        self._limits = limits

    def check(self, now: Situation) -> Finding | None:
        """The joint that is furthest beyond its bound, in the first group that has one."""
        for group in now.groups.values():
            if not group.engaged:
                continue
            error = group.following_error(now.measured.q)
            if 1 not in (np.abs(error) > self._limits.following_error[group.place]).tobytes():
                continue
            tick = now.measured.tick
            beyond = self._limits.following(group.index, error, _ESTOP_FACTOR, tick)
            if beyond is not None:
                return Finding(Reaction.ESTOP, beyond)
            fault = self._limits.following(group.index, error, 1.0, tick)
            if fault is not None:
                return Finding(Reaction.PROTECTIVE_STOP, fault, (group.name,))
        return None
