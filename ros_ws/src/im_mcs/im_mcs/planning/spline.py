"""Trajectories given as positions, velocities and accelerations at times, as ROS users send them.

The splines are those of ros2_controllers' ``JointTrajectoryController``: cubic where points have velocities, quintic
where they have accelerations too; the point before the first is the present setpoint. Two things differ:

- *Positions alone*: there they are joined by straight lines, whose velocity jumps at every point. No arm follows that
  and no limit allows it. Here they are joined by the spline that is continuous to acceleration: velocities and
  accelerations at the points are those of the cubic spline that ends at rest; the first and the last piece are
  quintics, which begin with the motion under way and end without acceleration.
- *The last point*: an acceleration given there is taken as 0. Where it has a velocity, the motion goes on and
  decelerates to rest, as quickly as limits allow; there the arm would be told to stop dead.

A cubic spline has jumps of acceleration at its points, as there; its position, velocity and acceleration are held to
the limits, its jerk cannot be.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from im_core.errors import LimitError
from im_mcs.planning.context import PlanContext
from im_mcs.planning.envelope import check_envelope
from im_mcs.planning.polynomial import PiecewisePolynomial, cubic, quintic
from im_mcs.planning.profile import with_run_out
from im_mcs.planning.trajectory import Setpoint, Trajectory
from im_mcs.protocol.points import TimedPoints
from im_mcs.protocol.requests import TrajectoryMove

_PIECES_A_SLICE = 12


class SplinePreparation:
    """Prepares a trajectory.

    Args:
        context: What it is planned with.
        move: Points in time.
        start: Gives the state it begins with.
    """

    def __init__(self, context: PlanContext, move: TrajectoryMove, start: Callable[[], Setpoint]) -> None:
        self._context, self._points, self._start = context, move.points, start
        self._limits = context.limits.motion.of(context.index)
        self._checked = 0

    def step(self) -> Trajectory | None:
        """Check some pieces; the last slice joins them to the present setpoint.

        Raises:
            LimitError: The spline goes beyond a limit, or the first point is at time 0 and elsewhere.
        """
        start = self._start()
        spline = with_run_out(_spline(*self._with_start(start), given=self._points), self._limits)
        if self._checked < len(spline.lengths):
            # from the end: what depends on the state at which it takes over comes last
            last = len(spline.lengths) - self._checked
            check_envelope(self._context, spline, slice(max(last - _PIECES_A_SLICE, 0), last))
            self._checked += _PIECES_A_SLICE
            if self._checked < len(spline.lengths):
                return None
        return spline

    def _with_start(
        self, start: Setpoint
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], list[int]]:
        """Times, positions, velocities and accelerations (NaN where not given), and where the points' pieces lead."""
        given = self._points
        missing = np.full_like(given.q, np.nan)
        v = missing if given.v is None else given.v
        a = missing.copy() if given.a is None else given.a.copy()
        a[-1] = 0.0
        first = 0 if given.times[0] > 0.0 else 1
        if first == 1:
            self._check_start(start)
        times = np.concatenate([[0.0], given.times[first:]])
        points = list(range(first, len(given.times)))
        if first == 1 and len(given.times) == 1:
            times, points, first = np.array([0.0, self._context.period_s]), [0], 0
        return (
            times,
            np.vstack([start.q, given.q[first:]]),
            np.vstack([start.v, v[first:]]),
            np.vstack([start.a, a[first:]]),
            points,
        )

    def _check_start(self, start: Setpoint) -> None:
        """A first point at time 0 is where the arm is, but for what it may be off its setpoint."""
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
                what="the first point is at time 0 and off the present setpoint by a distance that",
            )


def _spline(
    times: NDArray[np.float64],
    q: NDArray[np.float64],
    v: NDArray[np.float64],
    a: NDArray[np.float64],
    points: list[int],
    given: TimedPoints,
) -> PiecewisePolynomial:
    h = np.diff(times)
    if given.v is None:
        v, a = smooth(h, q, v[0], a[0])
        coefficients = quintic(h, q, v, a)
    elif given.a is None:
        coefficients = cubic(h, q, v)
    else:
        coefficients = quintic(h, q, v, a)
    return PiecewisePolynomial(h.tolist(), coefficients, points)


def smooth(
    h: NDArray[np.float64], q: NDArray[np.float64], v0: NDArray[np.float64], a0: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Velocities and accelerations at the points of the cubic spline from velocity ``v0`` to rest.

    Args:
        h: Times between points, shape (m,) [s].
        q: Positions, shape (m + 1, n).
        v0: Velocity at the first point, shape (n,).
        a0: Acceleration at the first point, shape (n,); that at the last is 0.

    Returns:
        Velocities and accelerations, shape (m + 1, n) each; the spline is continuous to acceleration between.
    """
    v, a = np.zeros_like(q), np.zeros_like(q)
    v[0], a[0] = v0, a0
    slope = np.diff(q, axis=0) / h[:, None]
    if len(h) > 1:
        # h[k] v[k-1] + 2 (h[k-1] + h[k]) v[k] + h[k-1] v[k+1] = 3 (h[k] slope[k-1] + h[k-1] slope[k])
        right = 3.0 * (h[1:, None] * slope[:-1] + h[:-1, None] * slope[1:])
        right[0] -= h[1] * v0
        bands = np.zeros((3, len(h) - 1))
        bands[0, 1:], bands[1], bands[2, :-1] = h[:-2], 2.0 * (h[:-1] + h[1:]), h[2:]
        v[1:-1] = solve_banded((1, 1), bands, right, overwrite_b=True)
        a[1:-1] = (6.0 * slope[1:] - 4.0 * v[1:-1] - 2.0 * v[2:]) / h[1:, None]
    return v, a
