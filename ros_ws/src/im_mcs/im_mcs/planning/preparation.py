"""Preparation of a motion in bounded slices, so that a long path never costs the loop its deadline."""

from im_mcs.planning.arguments import JointMove, LineMove, Move
from im_mcs.planning.context import PlanContext, Preparation, Start
from im_mcs.planning.joint_preparation import JointPreparation
from im_mcs.planning.line import LinePreparation
from im_mcs.planning.spline import SplinePreparation


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
        return LinePreparation(context, start().q, move)
    return SplinePreparation(context, move, start)
