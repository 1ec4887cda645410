"""Preparation of a motion in bounded slices, so that a long path never costs the loop its deadline."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from im_mcs.planning.arguments import JointMove, LineMove, Move
from im_mcs.planning.envelope import check_envelope
from im_mcs.planning.joint_path import JointPathPlanner
from im_mcs.planning.profile import to_point
from im_mcs.planning.setpoint import Setpoint
from im_mcs.planning.spline import SplinePreparation
from im_mcs.planning.trajectory import Trajectory

if TYPE_CHECKING:
    from im_mcs.config import McsConfig
    from im_mcs.limits import JointLimits
    from im_mcs.model import Model

_STEPS_A_SLICE = 5
# share of the jerk that a motion uses whose joints do not keep phase, so that it can be slowed down on its path
_SHARE = 0.6

Start = Callable[[], Setpoint]
"""Gives the state that a motion begins with if it begins at the next knot."""


@dataclass(frozen=True)
class PlanContext:
    """What a motion of one group is planned with.

    Attributes:
        model: Kinematics and dynamics.
        limits: Limits of all joints.
        index: Joints of the group among all, shape (n,).
        frame: Frame whose pose the group controls, if it has one.
        q_all: Gives the positions of all joints now, shape (18,) [rad or m].
        period_s: Time between two evaluations of a trajectory: a multiple of the servo period [s].
        config: Configuration.
    """

    model: "Model"
    limits: "JointLimits"
    index: NDArray[np.intp]
    frame: str | None
    q_all: Callable[[], NDArray[np.float64]]
    period_s: float
    config: "McsConfig"


class Preparation(Protocol):
    """A motion being prepared; nothing moves meanwhile because of it."""

    def step(self) -> Trajectory | None:
        """Do one slice of the work, of about 0.3 ms, counted in steps and never in time, so that it can be repeated.

        Returns:
            The trajectory (a :class:`~im_mcs.planning.polynomial.PiecewisePolynomial`), or None: call again next tick.

        Raises:
            ImError: The motion is refused.
        """
        ...


def prepare(context: PlanContext, move: Move, start: Start) -> Preparation:
    """Begin to prepare a motion.

    Args:
        context: What it is planned with.
        move: What is asked for.
        start: Gives the state it begins with; for a line that must be at rest.

    Raises:
        ImError: It is refused at once.
    """
    if isinstance(move, JointMove):
        return JointPreparation(context, move, start)
    if isinstance(move, LineMove):
        # the kinematics of a line need this package's own; joint motions do without
        from im_mcs.planning.line import LinePreparation

        return LinePreparation(context, start().q, move)
    return SplinePreparation(context, move, start)


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
