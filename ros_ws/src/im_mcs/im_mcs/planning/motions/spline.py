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
(:mod:`im_mcs.planning.retiming`), or refused, as ``planning.beyond_limits`` says. Of recorded positions noise is
smoothed first (:mod:`im_mcs.planning.motions.noise`). What takes over from a motion is tracked
(:mod:`im_mcs.planning.motions.tracked`).
"""

from collections.abc import Callable, Generator

import numpy as np

from im_core.errors import DataError, LimitError
from im_mcs.limits.motion_limits import BeyondLimits
from im_mcs.planning.checks.admission import POINTS_AT_ONCE, check_timed_points
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.checks.envelope import check_range, first_excess, slowdown
from im_mcs.planning.motions.noise import is_noisy, smoothed
from im_mcs.planning.motions.tracked import TrackedTrajectory
from im_mcs.planning.retiming import RetimedTrajectory, retime
from im_mcs.planning.trajectories.interpolation import interpolated
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial
from im_mcs.planning.trajectories.trajectory import Setpoint, Trajectory
from im_mcs.protocol.points import TimedPoints
from im_mcs.protocol.requests import TrajectoryMove

# pieces whose range is looked at in one slice
_PIECES_IN_RANGE = 100
# of a client's tolerance that smoothing may use: the rest is for the arm
_SHARE_OF_TOLERANCE = 0.5
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
        units = [context.limits.units[i] for i in context.index]
        noise = context.config.planning.noise
        default = np.array([noise.rad if unit == "rad" else noise.m for unit in units])
        asked = np.zeros(len(units)) if len(move.path_tolerance) == 0 else np.array(move.path_tolerance)
        self._noise = np.where(asked > 0.0, _SHARE_OF_TOLERANCE * asked, default)
        self._tracked = at_once
        self._work: Generator[None, None, Trajectory] | None = None
        self._from = np.empty(0)

    def step(self) -> Trajectory | None:
        """Check or re-time some pieces.

        Raises:
            LimitError: It goes beyond a limit that holds it up, or the first point is at time 0 and elsewhere.
            DataError: Recorded positions have more noise than may be smoothed.
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
        if self._points.v is None and is_noisy(self._points.times, self._points.q, self._limits):
            return (yield from self._without_noise(start, spline, fault))
        return (yield from retime(self._context, spline, fault))

    def _without_noise(
        self, start: Setpoint, asked: PiecewisePolynomial, fault: LimitError
    ) -> Generator[None, None, RetimedTrajectory]:
        """Return the motion through the positions without their noise, re-timed where it is still beyond limits.

        Raises:
            DataError: There is more noise than may be smoothed; tells how long the motion would take.
        """
        context, points = self._context, self._points
        times, q = points.times, points.q
        if times[0] > 0.0:
            times, q = np.append(0.0, times), np.vstack([start.q, q])
        still = yield from smoothed(times, q, self._limits, self._noise)
        some = len(still) - len(points.q)
        spline = yield from interpolated(TimedPoints(points.times, still[some:], None, None), start, self._limits)
        check_range(context, spline)
        if is_noisy(times, still, self._limits):
            seconds = asked.duration * slowdown(spline, self._limits, slice(None))
            raise DataError(
                f"noise of the positions goes on after smoothing by what is allowed ({self._noise.min():g} to "
                f"{self._noise.max():g}, half of a path_tolerance): along that path the motion would take "
                f"{seconds:.1f} s instead of {asked.duration:.3f} s; give a larger path_tolerance, or smooth it before",
                value=seconds,
            )
        left = yield from first_excess(context, spline, range(len(spline.lengths)), start.a)
        if left is None:
            edges = np.append(spline.edges, spline.duration)
            found = RetimedTrajectory(spline.lengths, spline.coefficients, spline.points, edges, asked, fault)
        else:
            found = yield from retime(context, spline, left)
            found.asked = asked
        off = np.abs(still - q)
        k = int((off / self._noise).max(axis=0).argmax())
        i = context.index[k]
        found.smoothed = (
            f"noise of positions smoothed by up to {off[:, k].max():.3g} {context.limits.units[i]} "
            f"({context.limits.names[i]})"
        )
        return found

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
