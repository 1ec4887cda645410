"""Preparation of a joint-interpolated motion in bounded slices."""

from dataclasses import replace

from im_mcs.planning.arguments import JointMove
from im_mcs.planning.context import PlanContext, Start
from im_mcs.planning.envelope import check_envelope
from im_mcs.planning.joint_path import JointPathPlanner
from im_mcs.planning.profile import to_point
from im_mcs.planning.trajectory import Trajectory

_STEPS_A_SLICE = 5
# share of the jerk that a motion uses whose joints do not keep phase, so that it can be slowed down on its path
_SHARE = 0.6


class JointPreparation:
    """Prepares a joint-interpolated motion.

    From rest it is a :class:`~im_mcs.planning.joint_path.JointPath`. From a motion under way the first point is
    reached, at rest, by the time-optimal motion from the state at which it takes over, then the rest follows.

    Args:
        context: What it is planned with.
        move: Points.
        start: Gives the state it begins with.
    """

    def __init__(self, context: PlanContext, move: JointMove, start: Start) -> None:
        self._context, self._start = context, start
        self._limits = context.limits.motion.of(context.index)
        state = start()
        self._moving = bool(state.v.any() or state.a.any())
        self._first = move.points[0]
        synchrony = context.config.planning.synchrony
        begin, points = (move.points[0], move.points[1:]) if self._moving else (state.q, move.points)
        self._legs = JointPathPlanner(begin, points, self._limits, synchrony, move.blend)

    def step(self) -> Trajectory | None:
        """A few steps; the last slice joins them to the motion under way."""
        if not self._legs.done:
            for _ in range(_STEPS_A_SLICE):
                if not self._legs.done:
                    self._legs.step()
            return None
        if not self._moving:
            return self._legs.trajectory
        synchrony = self._context.config.planning.synchrony
        limits = replace(self._limits, jerk=self._limits.jerk * _SHARE)
        first = to_point(self._start(), self._first, limits, synchrony)
        # a motion that turns round may swing past the range of a joint
        check_envelope(self._context, first, positions_only=True)
        rest = self._legs.trajectory
        rest.points = [point + 1 for point in rest.points]
        return first.followed_by([rest]) if rest.duration > 0.0 else first
