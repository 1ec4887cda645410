"""Window of a stream: points from some moments ago to some moments ahead, each message in place of the one before.

Whoever streams (``moveit_servo``, a joystick) sends one point at a time or a window of them, stamped or for now. The
window says where the arm is to be at every instant from its first point on. It is tracked
(:mod:`im_mcs.planning.motions.tracked`) from the present moment, in its own time: a point whose time is over is no
reason to refuse the others, and what cannot be kept is met later.

- Points with velocities are joined by the splines of every trajectory, positions alone by straight lines.
- Before a point with a velocity, and behind it, lies a straight line. Of the points before and after that message,
  which nobody has, it is the best guess: what is made for is the same, whichever message it was learnt from.
- Behind a velocity in its last point the window goes on along that line until 0.1 s after it came: by then there is
  another one. If none comes, the motion decelerates to rest within limits. Where the range of a joint has no room for
  that, the motion decelerates behind the last point.
"""

import math
from collections.abc import Callable, Generator

import numpy as np

from im_core.errors import LimitError
from im_mcs.planning.checks.context import PlanContext, Start
from im_mcs.planning.checks.envelope import check_range
from im_mcs.planning.motions.tracked import TrackedTrajectory
from im_mcs.planning.trajectories.interpolation import interpolated
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial
from im_mcs.planning.trajectories.profile import STILL
from im_mcs.planning.trajectories.trajectory import Setpoint
from im_mcs.protocol.points import TimedPoints
from im_mcs.protocol.requests import TrajectoryMove

# for how long there is a line: before the first point at most, from the arrival on, and as far as may be made for
_BEFORE_S, _RUN_ON_S, _AHEAD_S = 0.1, 0.1, 1.0
# times that differ by less are the same: rounding
_SAME_S = 1e-6


class WindowPreparation:
    """Prepares a window of a stream, or one point for now.

    Args:
        context: What it is planned with.
        move: Points in time.
        start: Gives the state it begins with.
        passed_s: Gives the time on the window's clock when it begins [s].
    """

    def __init__(self, context: PlanContext, move: TrajectoryMove, start: Start, passed_s: Callable[[], float]) -> None:
        self._context, self._points, self._start, self._passed_s = context, move.points, start, passed_s
        self._limits = context.limits.motion.of(context.index)
        self._work = self._prepare()

    def step(self) -> TrackedTrajectory | None:
        """Join some hundred points; a window has fewer.

        Raises:
            LimitError: It would leave the range of a joint, or come to rest beyond it.
            DataError: Ruckig finds no deceleration.
        """
        try:
            next(self._work)
        except StopIteration as done:
            course, begin_s, end_s = done.value
            return TrackedTrajectory.of(course, self._passed_s() - begin_s, end_s - begin_s, streamed=True)
        return None

    def _prepare(self) -> Generator[None, None, tuple[PiecewisePolynomial, float, float]]:
        """Return the course, and the times on the window's clock at which it begins and ends [s]."""
        points, now_s = self._points, self._passed_s()
        end_s = float(points.times[-1])
        if points.v is None or np.abs(points.v[-1]).max() <= STILL:
            course, begin_s = yield from self._joined(points, now_s)
            check_range(self._context, course)
            return course, begin_s, math.inf
        ends = (max(now_s + _RUN_ON_S, end_s), end_s)
        for end_s in ends:
            course, begin_s = yield from self._joined(self._longer(end_s), now_s)
            try:
                check_range(self._context, course)
                break
            except LimitError:
                if end_s == ends[-1]:
                    raise
        course, begin_s = yield from self._joined(self._longer(end_s + _AHEAD_S), now_s)
        return course, begin_s, end_s

    def _longer(self, end_s: float) -> TimedPoints:
        """Return the points, and one more on the straight line behind the last one, at a speed within limits."""
        points = self._points
        assert points.v is not None
        seconds = end_s - float(points.times[-1])
        if seconds <= _SAME_S:
            return points
        v = points.v[-1] / max(float((np.abs(points.v[-1]) / self._limits.velocity).max()), 1.0)
        return TimedPoints(
            np.append(points.times, end_s),
            np.vstack([points.q, points.q[-1] + v * seconds]),
            np.vstack([points.v, v]),
            None if points.a is None else np.vstack([points.a, np.zeros_like(v)]),
        )

    def _joined(self, points: TimedPoints, now_s: float) -> Generator[None, None, tuple[PiecewisePolynomial, float]]:
        """Join the last point that is over and those to come; return the course, and when it begins [s]."""
        over = int(np.searchsorted(points.times, now_s + _SAME_S, side="right")) - 1
        if over == len(points.times) - 1:
            return PiecewisePolynomial.standing(points.q[over]), now_s
        start, begin_s = self._start(), now_s
        zero = np.zeros_like(start.q)
        if over >= 0:
            begin_s = float(points.times[over])
            start = Setpoint(points.q[over], *(zero if x is None else x[over] for x in (points.v, points.a)))
        elif points.v is not None and (wait_s := float(points.times[0]) - now_s) <= _BEFORE_S:
            start = Setpoint(points.q[0] - points.v[0] * wait_s, points.v[0], zero)
        ahead = points.since(over + 1, -begin_s)
        if ahead.v is not None:
            return (yield from interpolated(ahead, start, self._limits)), begin_s
        h, q = np.diff(ahead.times, prepend=0.0), np.vstack([start.q, ahead.q])
        coefficients = np.zeros((len(h), 6, q.shape[1]))
        coefficients[:, 0], coefficients[:, 1] = q[:-1], np.diff(q, axis=0) / h[:, None]
        return PiecewisePolynomial(h, coefficients, range(over + 1, len(points.times))), begin_s
