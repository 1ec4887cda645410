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
(:mod:`im_mcs.planning.retiming`), or refused, as ``planning.beyond_limits`` says. What takes over from a motion is
tracked (:mod:`im_mcs.planning.motions.tracked`).
"""

from collections.abc import Callable, Generator

import numpy as np

from im_core.errors import LimitError
from im_mcs.limits.motion_limits import BeyondLimits
from im_mcs.planning.checks.admission import POINTS_AT_ONCE, check_timed_points
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.checks.envelope import check_range, first_excess
from im_mcs.planning.motions.tracked import TrackedTrajectory
from im_mcs.planning.retiming import retime
from im_mcs.planning.trajectories.interpolation import interpolated
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial
from im_mcs.planning.trajectories.trajectory import Setpoint, Trajectory
from im_mcs.protocol.requests import TrajectoryMove

# pieces whose range is looked at in one slice
_PIECES_IN_RANGE = 100
# slices between two ticks, for each second of the period: of what is short, and of what is long, whose slices are full
_SHORT_S, _SLICES_OF_SHORT, _SLICES_OF_LONG = 2.0, 1400.0, 500.0


class SplinePreparation:
    """Prepares a trajectory.

    From rest it is checked, and re-timed if it must be. One that takes over from a motion under way, or from another
    that has not begun, is tracked instead: it begins without delay.

    Args:
        context: What it is planned with.
        move: Points in time.
        start: Gives the state it begins with.
        at_once: Whether it is tracked from rest, too.
    """

    def __init__(
        self, context: PlanContext, move: TrajectoryMove, start: Callable[[], Setpoint], *, at_once: bool
    ) -> None:
        self._context, self._points, self._start = context, move.points, start
        self._limits = context.limits.motion.of(context.index)
        rate = _SLICES_OF_SHORT if move.points.times[-1] <= _SHORT_S else _SLICES_OF_LONG
        self._slices = max(round(rate * context.config.servo.period_s), 1)
        self._tracked = at_once
        self._work: Generator[None, None, Trajectory] | None = None
        self._from = np.empty(0)

    def step(self) -> Trajectory | None:
        """Check or re-time some pieces.

        Raises:
            LimitError: It goes beyond a limit that holds it up, or the first point is at time 0 and elsewhere.
        """
        start = self._start()
        moves = bool(start.v.any() or start.a.any())
        # what is tracked may begin elsewhere than where its preparation has
        if self._work is None or (not self._tracked and (moves or not np.array_equal(start.q, self._from))):
            self._tracked |= moves
            self._work, self._from = self._prepare(start), start.q
        try:
            for _ in range(self._slices):
                next(self._work)
        except StopIteration as done:
            trajectory: Trajectory = done.value
            return trajectory
        return None

    def _prepare(self, start: Setpoint) -> Generator[None, None, Trajectory]:
        for k in range(POINTS_AT_ONCE, len(self._points.times), POINTS_AT_ONCE):
            check_timed_points(self._context, self._points, k)
            yield
        spline = yield from self._interpolated(start)
        for k in range(0, len(spline.lengths), _PIECES_IN_RANGE):
            if k or not self._tracked:
                yield
            check_range(self._context, spline, slice(k, k + _PIECES_IN_RANGE))
        refuses = self._context.config.planning.beyond_limits is BeyondLimits.REFUSE
        if self._tracked and not refuses:
            return TrackedTrajectory.of(spline)
        fault = yield from first_excess(self._context, spline, range(len(spline.lengths)), start.a)
        if fault is None:
            return TrackedTrajectory.of(spline) if self._tracked else spline
        if refuses:
            raise fault
        return (yield from retime(self._context, spline, fault))

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
