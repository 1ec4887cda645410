"""Trajectories given as positions, velocities and accelerations at times, as ROS users send them.

The splines are those of ros2_controllers' ``JointTrajectoryController``: cubic where points have velocities, quintic
where they have accelerations too; the point before the first is the present setpoint. Two things differ:

- *Positions alone*: there they are joined by straight lines, whose velocity jumps at every point. No arm follows that
  and no limit allows it. Here they are joined by the spline that is continuous to acceleration: velocities and
  accelerations at the points are those of the cubic spline that ends at rest; the first and the last piece are
  quintics, which begin with the motion under way and end without acceleration.
- *The last point*: an acceleration given there is taken as 0. Where it has a velocity, the motion goes on and
  decelerates to rest, as quickly as limits allow; there the arm would be told to stop dead.

- *Two points one after the other in the same place*: given positions alone, the arm rests between them.

What leaves the range of a joint is refused. What is beyond a limit of velocity, acceleration or jerk between its
points, as trapezoidal profiles and cubic splines are (their acceleration jumps), is re-timed along its own path
(:mod:`im_mcs.planning.retiming`), or refused, as ``planning.beyond_limits`` says.
"""

from collections.abc import Callable, Generator

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from im_core.errors import ImError, LimitError
from im_mcs.limits.motion_limits import BeyondLimits
from im_mcs.planning.context import PlanContext
from im_mcs.planning.envelope import check_range, first_excess, force_at_end
from im_mcs.planning.polynomial import PiecewisePolynomial, cubic, quintic
from im_mcs.planning.profile import with_run_out
from im_mcs.planning.retiming import retime
from im_mcs.planning.trajectory import Setpoint, Trajectory
from im_mcs.protocol.points import TimedPoints
from im_mcs.protocol.requests import TrajectoryMove

_PIECES_A_SLICE, _PIECES_IN_RANGE = 12, 100
# so many points can be joined anew to a motion under way in every slice
_MOST_ON_THE_MOVE = 1000
_SAME = 1e-12


class RestNeededError(ImError):
    """A trajectory can be prepared only from rest: it does not take over from a motion, which is to end first."""

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
        spline = self._spline(start)
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
        """The trajectory from the motion under way, once all its pieces are known to keep the limits."""
        if len(self._points.times) > _MOST_ON_THE_MOVE:
            raise RestNeededError(f"a trajectory of {len(self._points.times)} points begins at rest")
        spline = self._spline(start)
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
                raise RestNeededError(f"it cannot take over as it is: {fault.message}")
            self._checked += _PIECES_A_SLICE
        return spline if self._checked >= count else None

    def _spline(self, start: Setpoint) -> PiecewisePolynomial:
        # what is absurdly fast becomes infinite, and is out of range
        with np.errstate(over="ignore", invalid="ignore"):
            return with_run_out(_spline(*self._with_start(start), given=self._points), self._limits)

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
        Velocities and accelerations, shape (m + 1, n) each; the spline is continuous to acceleration between. Both are
        0 at two points one after the other in the same place.
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
        still: NDArray[np.bool_] = np.all(np.abs(q[1:] - q[:-1]) <= _SAME, axis=1)
        rests: NDArray[np.bool_] = still[:-1] | still[1:]
        right[rests], bands[1, rests] = 0.0, 1.0
        bands[0, 1:][rests[:-1]] = bands[2, :-1][rests[1:]] = 0.0
        v[1:-1] = solve_banded((1, 1), bands, right, overwrite_b=True)
        a[1:-1] = np.where(rests[:, None], 0.0, (6.0 * slope[1:] - 4.0 * v[1:-1] - 2.0 * v[2:]) / h[1:, None])
    return v, a


def _run(work: Generator[None, None, LimitError | None]) -> LimitError | None:
    """All slices at once."""
    while True:
        try:
            next(work)
        except StopIteration as done:
            fault: LimitError | None = done.value
            return fault
