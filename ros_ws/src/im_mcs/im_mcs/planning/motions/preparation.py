"""Preparation of a motion in bounded slices, so a long path never costs the loop the deadline."""

from collections.abc import Callable
from typing import Protocol

from im_mcs.planning.checks.context import PlanContext, Start
from im_mcs.planning.motions.spline import SplinePreparation
from im_mcs.planning.motions.window import WindowPreparation
from im_mcs.planning.trajectories.trajectory import Trajectory
from im_mcs.protocol.requests import JointMove, LineMove, Move


class Preparation(Protocol):
    """Motion in preparation; nothing moves meanwhile because of the preparation."""

    def step(self) -> Trajectory | None:
        """Do one slice of the work, of about 0.3 ms, counted in steps and never in time, for repeatable runs.

        Returns:
            The trajectory (a :class:`~im_mcs.planning.trajectories.polynomial.PiecewisePolynomial`), or None: call
            again next tick.

        Raises:
            ImError: The motion is refused.
        """
        ...


def prepare(
    context: PlanContext, move: Move, start: Start, passed_s: Callable[[], float], *, at_once: bool
) -> Preparation:
    """Begin to prepare a motion.

    Args:
        context: What it is planned with.
        move: What is asked for.
        start: Gives the state it begins with; for a line that must be at rest.
        passed_s: Gives the time on the clock of a stream when it begins [s].
        at_once: Whether a trajectory begins before it could be re-timed.

    Raises:
        ImError: It is refused at once.
    """
    if isinstance(move, JointMove):
        return context.generators["joint"](context, move, start)  # type: ignore[no-any-return]
    if isinstance(move, LineMove):
        return context.generators["line"](context, move, start)  # type: ignore[no-any-return]
    if move.stream or move.points.times[-1] == 0.0:
        return WindowPreparation(context, move, start, passed_s)
    return SplinePreparation(context, move, start, at_once=at_once)
