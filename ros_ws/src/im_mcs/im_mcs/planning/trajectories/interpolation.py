"""The spline through points in time, built some pieces a slice: a trajectory may have thousands of points."""

from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial, cubic, quintic
from im_mcs.planning.trajectories.profile import STILL, with_run_out
from im_mcs.planning.trajectories.trajectory import Setpoint
from im_mcs.protocol.points import TimedPoints

PIECES_AT_ONCE = 500
"""Pieces that are built in one slice."""
# Of the velocity of a smooth spline at a point, what lies one point further off has at most half the weight.
_NEIGHBOURS = 60
# each sweep at least halves what velocities are off the gentlest ones that keep their bounds
_SWEEPS = 8
_SAME = 1e-12


def interpolated(
    given: TimedPoints, start: Setpoint, limits: MotionLimits
) -> Generator[None, None, PiecewisePolynomial]:
    """Return the spline from a state through points, with the deceleration behind the last one.

    Args:
        given: The points; one at time 0 is where the motion begins, and does not count.
        start: State at time 0.
        limits: Of the joints.
    """
    first = 0 if given.times[0] > 0.0 else 1
    times = np.concatenate([[0.0], given.times[first:]])
    h = np.diff(times)
    spline = _Pieces(given, start, first, h)
    count = len(h)
    end = PiecewisePolynomial(h[-1:], spline.coefficients(count - 1, count))
    if given.v is not None and np.abs(given.v[-1]).max() > STILL:  # else what moves there is rounding
        end = with_run_out(end, limits)
    coefficients = np.empty((count - 1 + len(end.lengths), *end.coefficients.shape[1:]))
    coefficients[count:] = end.coefficients[1:]
    for begin in range(0, count, PIECES_AT_ONCE):
        if begin:
            yield
        stop = min(begin + PIECES_AT_ONCE, count)
        coefficients[begin:stop] = spline.coefficients(begin, stop)
    last = len(given.times) - 1
    points = [*range(first, last + 1), *[last] * (len(end.lengths) - 1)]
    return PiecewisePolynomial(np.append(h, end.lengths[1:]), coefficients, points)


class _Pieces:
    """Pieces of the spline.

    Args:
        given: Points.
        start: State before the first of them.
        first: Which of them that is.
        h: Length of every piece, shape (m,) [s].
    """

    def __init__(self, given: TimedPoints, start: Setpoint, first: int, h: NDArray[np.float64]) -> None:
        self._given, self._start, self._first, self._h = given, start, first, h

    def coefficients(self, begin: int, stop: int) -> NDArray[np.float64]:
        """Of some pieces, shape (stop - begin, 6, n)."""
        given, start, h, count = self._given, self._start, self._h[begin:stop], len(self._h)
        # what is absurdly fast becomes infinite, and is out of range
        with np.errstate(over="ignore", invalid="ignore"):
            if given.v is None:
                low, high = max(begin - _NEIGHBOURS, 0), min(stop + _NEIGHBOURS, count)
                q = self._rows(given.q, start.q, low, high)
                v0, a0 = (start.v, start.a) if low == 0 else (np.zeros_like(start.v),) * 2
                some = slice(begin - low, stop - low + 1)
                return quintic(h, q[some], *(x[some] for x in smooth(self._h[low:high], q, v0, a0)))
            q, v = self._rows(given.q, start.q, begin, stop), self._rows(given.v, start.v, begin, stop)
            if given.a is None:
                return cubic(h, q, v)
            a = self._rows(given.a, start.a, begin, stop)
            if stop == count:
                a = np.vstack([a[:-1], np.zeros_like(a[-1])])
            return quintic(h, q, v, a)

    def _rows(
        self, values: NDArray[np.float64], before: NDArray[np.float64], begin: int, stop: int
    ) -> NDArray[np.float64]:
        """Values at both ends of some pieces, shape (stop - begin + 1, n)."""
        last = self._first + stop
        return np.vstack([before, values[self._first : last]]) if begin == 0 else values[self._first + begin - 1 : last]


def smooth(
    h: NDArray[np.float64], q: NDArray[np.float64], v0: NDArray[np.float64], a0: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return velocities and accelerations at the points of a spline from ``v0`` to rest without overshoot of any point.

    Where the cubic spline that is continuous to acceleration keeps velocities within :func:`velocity_bounds`, it is
    that one. Elsewhere it is the one that bends least within them (G. Wolberg, I. Alfy, "An energy-minimization
    framework for monotonic cubic spline interpolation", 2002), found by projected Jacobi sweeps.

    Args:
        h: Times between points, shape (m,) [s].
        q: Positions, shape (m + 1, n).
        v0: Velocity at the first point, shape (n,).
        a0: Acceleration at the first point, shape (n,); that at the last is 0.

    Returns:
        Velocities and accelerations, shape (m + 1, n) each, for quintics between. Both are 0 at two points one after
        the other in the same place.
    """
    v, a = np.zeros_like(q), np.zeros_like(q)
    v[0], a[0] = v0, a0
    slope = np.diff(q, axis=0) / h[:, None]
    if len(h) > 1:
        # h[k] v[k-1] + 2 (h[k-1] + h[k]) v[k] + h[k-1] v[k+1] = 3 (h[k] slope[k-1] + h[k-1] slope[k])
        right = 3.0 * (h[1:, None] * slope[:-1] + h[:-1, None] * slope[1:])
        right[0] -= h[1] * v0
        before, middle, after = h[2:].copy(), 2.0 * (h[:-1] + h[1:]), h[:-2].copy()
        still: NDArray[np.bool_] = np.all(np.abs(q[1:] - q[:-1]) <= _SAME, axis=1)
        rests: NDArray[np.bool_] = still[:-1] | still[1:]
        right[rests], middle[rests] = 0.0, 1.0
        before[rests[1:]] = after[rests[:-1]] = 0.0
        v[1:-1] = solve_tridiagonal(before, middle, after, right)
        low, high = velocity_bounds(h, slope)
        beyond = np.flatnonzero(((v[1:-1] < low) | (v[1:-1] > high)).any(axis=1))
        if beyond.size:
            # the equations from the first to the last of these, and as far around as sweeps reach
            some = slice(max(int(beyond[0]) - _SWEEPS, 0), int(beyond[-1]) + _SWEEPS + 1)
            before, after = np.append(0.0, before)[some, None], np.append(after, 0.0)[some, None]
            middle, right, low, high = middle[some, None], right[some], low[some], high[some]
            part = v[some.start : some.stop + 2]
            part[1:-1] = np.clip(part[1:-1], low, high)
            for _ in range(_SWEEPS):
                part[1:-1] = np.clip((right - before * part[:-2] - after * part[2:]) / middle, low, high)
        a[1:-1] = np.where(rests[:, None], 0.0, (6.0 * slope[1:] - 4.0 * v[1:-1] - 2.0 * v[2:]) / h[1:, None])
        if beyond.size:
            # the smaller of what the cubics on both sides have, 0 if these have different signs
            left = (4.0 * part[1:-1] + 2.0 * part[:-2] - 6.0 * slope[:-1][some]) / h[:-1][some, None]
            right = a[1:-1][some]
            smaller = np.sign(left) * np.minimum(np.abs(left), np.abs(right))
            a[1:-1][some] = np.where(left * right > 0.0, smaller, 0.0)
    return v, a


def velocity_bounds(
    h: NDArray[np.float64], slope: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and largest velocities at inner points with which a spline does not swing far beyond any point.

    Between two slopes of one sign it is monotone (F. N. Fritsch, R. E. Carlson, "Monotone piecewise cubic
    interpolation", 1980: three times the smaller slope). Where it turns round it goes on behind the point, by up to
    4/27 of the longer way before or after it.

    Args:
        h: Times between points, shape (m,) [s].
        slope: Mean velocities between points, shape (m, n).

    Returns:
        Bounds, shape (m - 1, n) each.
    """
    size = np.abs(slope)
    most = 3.0 * np.minimum(size[:-1], size[1:])
    turns = slope[:-1] * slope[1:] < 0.0
    way = size * h[:, None]
    most[turns] = (np.maximum(way[:-1], way[1:]) / np.maximum(h[:-1], h[1:])[:, None])[turns]
    least = np.minimum(slope[:-1], slope[1:])
    return np.where(least < 0.0, -most, 0.0), np.where((least > 0.0) | turns, most, 0.0)


def solve_tridiagonal(
    before: NDArray[np.float64], middle: NDArray[np.float64], after: NDArray[np.float64], right: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Solve a tridiagonal system with a dominant diagonal, by parallel cyclic reduction.

    Each round frees the equations of the neighbours that they have, and couples them to those twice as far off
    (Hockney and Jesshope, "Parallel Computers 2", 1988). SciPy's solver takes the servo as long to load as all else.

    Args:
        before: Below the diagonal, shape (m - 1,).
        middle: The diagonal, shape (m,).
        after: Above it, shape (m - 1,).
        right: Right sides, shape (m, n).

    Returns:
        The solutions, shape (m, n).
    """
    reach = 1
    while reach < len(middle):
        down, up = -before / middle[:-reach], -after / middle[reach:]
        next_middle, next_right = middle.copy(), right.copy()
        next_middle[reach:] += down * after
        next_middle[:-reach] += up * before
        next_right[reach:] += down[:, None] * right[:-reach]
        next_right[:-reach] += up[:, None] * right[reach:]
        before, after = down[reach:] * before[:-reach], up[:-reach] * after[reach:]
        middle, right = next_middle, next_right
        reach *= 2
    return np.asarray(right / middle[:, None])
