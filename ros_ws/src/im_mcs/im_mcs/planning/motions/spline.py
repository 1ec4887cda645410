"""Trajectories given as positions, velocities and accelerations at times, as sent by ROS users.

The splines are those of ros2_controllers' ``JointTrajectoryController``: cubic where points have velocities, quintic
where they have accelerations too; the point before the first is the present setpoint. Two things differ:

- *Positions alone*: there they are joined by straight lines, whose velocity jumps at every point. No arm follows that
  and no limit allows it. Here they are joined by a spline that is continuous to acceleration: velocities and
  accelerations at the points are those of the cubic spline that ends at rest; the first and the last piece are
  quintics, which begin with the motion under way and end without acceleration. Where that spline would swing beyond the
  points, as where a far way in a short time is followed by a slow one, its velocities are bounded
  (:func:`~im_mcs.planning.trajectories.interpolation.velocity_bounds`).
- *The last point*: an acceleration given there is taken as 0. Where it has a velocity, the motion goes on and
  decelerates to rest, as quickly as limits allow; there the arm would be told to stop dead.

- *Two points one after the other in the same place*: given positions alone, the arm rests between them.

What leaves the range of a joint is refused. What is beyond a limit of velocity, acceleration or jerk between its
points, as trapezoidal profiles and cubic splines are (their acceleration jumps), is re-timed along its own path
(:mod:`im_mcs.planning.retiming`), or refused, as ``planning.beyond_limits`` says.
"""

from collections.abc import Callable, Generator
from typing import TypeVar

import numpy as np

from im_core.errors import ImError, LimitError
from im_mcs.limits.motion_limits import BeyondLimits
from im_mcs.planning.checks.admission import POINTS_AT_ONCE, check_timed_points
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.checks.envelope import check_range, first_excess, force_at_end
from im_mcs.planning.retiming import retime
from im_mcs.planning.trajectories.interpolation import interpolated
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial
from im_mcs.planning.trajectories.trajectory import Setpoint, Trajectory
from im_mcs.protocol.requests import TrajectoryMove

_PIECES_A_SLICE, _PIECES_IN_RANGE = 12, 100
# so many points can be joined anew to a motion under way in every slice
_MOST_ON_THE_MOVE = 1000
ResultT = TypeVar("ResultT")


class RestNeededError(ImError):
    """Trajectory with a preparation only from rest: the motion before must end first."""

    default_code = "rest_needed"


class SplinePreparation:
    """Prepares a trajectory.

    From rest it is checked, and re-timed if it must be. From a motion under way it is joined to that anew in every
    slice, and taken as it is or not at all.

    Args:
        context: What it is planned with.
        move: Points in time.
        start: Gives the state it begins with.
    """

    def __init__(self, context: PlanContext, move: TrajectoryMove, start: Callable[[], Setpoint]) -> None:
        self._context, self._points, self._start = context, move.points, start
        self._limits = context.limits.motion.of(context.index)
        self._work: Generator[None, None, Trajectory] | None = None
        self._from = np.empty(0)
        self._checked = 0

    def step(self) -> Trajectory | None:
        """Check or re-time some pieces.

        Raises:
            LimitError: It goes beyond a limit that holds it up, or the first point is at time 0 and elsewhere.
            RestNeededError: It begins with a motion, and would have to be re-timed, or is too long.
        """
        start = self._start()
        if start.v.any() or start.a.any():
            self._work = None
            return self._joined(start)
        if self._work is None or not np.array_equal(start.q, self._from):
            self._work, self._from = self._prepare(start), start.q
        try:
            next(self._work)
        except StopIteration as done:
            trajectory: Trajectory = done.value
            return trajectory
        return None

    def _prepare(self, start: Setpoint) -> Generator[None, None, Trajectory]:
        """The trajectory from rest."""
        for k in range(POINTS_AT_ONCE, len(self._points.times), POINTS_AT_ONCE):
            check_timed_points(self._context, self._points, k)
            yield
        spline = yield from self._interpolated(start)
        for k in range(0, len(spline.lengths), _PIECES_IN_RANGE):
            yield
            check_range(self._context, spline, slice(k, k + _PIECES_IN_RANGE))
        fault = yield from first_excess(self._context, spline, range(len(spline.lengths)), start.a)
        if fault is None:
            return spline
        if self._context.config.planning.beyond_limits is BeyondLimits.REFUSE:
            raise fault
        return (yield from retime(self._context, spline, fault))

    def _joined(self, start: Setpoint) -> Trajectory | None:
        """Return the trajectory from the motion under way, once all the pieces are proved within the limits."""
        if len(self._points.times) > _MOST_ON_THE_MOVE:
            raise RestNeededError(f"a trajectory of {len(self._points.times)} points begins at rest")
        spline = _run(self._interpolated(start))
        count = len(spline.lengths)
        if self._checked < count:
            # from the end: what depends on the state at which it takes over comes last
            first = max(count - self._checked - _PIECES_A_SLICE, 0)
            pieces = slice(first, count - self._checked)
            check_range(self._context, spline, pieces)
            before = start.a if first == 0 else force_at_end(spline, slice(first - 1, first))[0]
            fault = _run(first_excess(self._context, spline, range(first, pieces.stop), before))
            if fault is not None:
                if self._context.config.planning.beyond_limits is BeyondLimits.REFUSE:
                    raise fault
                raise RestNeededError(f"the new trajectory cannot take over without a stop: {fault.message}")
            self._checked += _PIECES_A_SLICE
        return spline if self._checked >= count else None

    def _interpolated(self, start: Setpoint) -> Generator[None, None, PiecewisePolynomial]:
        """The spline; a point at time 0 is where the motion begins."""
        if self._points.times[0] == 0.0:
            self._check_start(start)
        return (yield from interpolated(self._points, start, self._limits))

    def _check_start(self, start: Setpoint) -> None:
        """Check whether a first point at time 0 is the arm's place, within the following error."""
        limits, index = self._context.limits, self._context.index
        off = np.abs(self._points.q[0] - start.q)
        beyond = off > limits.following_error[index]
        if beyond.any():
            k = int(np.argmax(beyond))
            i = index[k]
            raise LimitError(
                joint=limits.names[i],
                value=float(off[k]),
                limit=float(limits.following_error[i]),
                unit=limits.units[i],
                what="distance of the first point, at time 0, from the present setpoint",
            )


def _run(work: Generator[None, None, ResultT]) -> ResultT:
    """All slices at once."""
    while True:
        try:
            next(work)
        except StopIteration as done:
            result: ResultT = done.value
            return result
