"""Whether a whole trajectory keeps to the limits, judged before anything moves, on a grid finer than the servo's."""

from collections.abc import Generator
from functools import cache
from math import comb

import numpy as np
from numpy.typing import NDArray

from im_core.errors import LimitError
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial

Array = NDArray[np.float64]

# of one piece, both ends included: what is given as points in time has long pieces, a fitted line pieces of 20 ms
_SAMPLES, _SAMPLES_OF_SHORT = 257, 9
_TOLERANCE = 1e-4
# jumps of acceleration that come from rounding, as a share of what the limit of jerk allows between two evaluations
_JUMP = 0.01
_NAMES = (("position", ""), ("velocity", "/s"), ("acceleration", "/s2"), ("jerk", "/s3"))
_PIECES_CLOSE, _PIECES_CLEARED = 12, 60


def check_range(context: PlanContext, trajectory: PiecewisePolynomial, pieces: slice = slice(None)) -> None:
    """Check whether some pieces, all without any named, stay within the joints' ranges.

    Raises:
        LimitError: One does not; names joint, value, limit, unit and time.
    """
    limits, index = context.limits, context.index
    lower, upper = limits.lower[index], limits.upper[index]
    near = _not_cleared(trajectory, pieces, 0, lower, upper)
    fault = _first_beyond(context, trajectory, near, 0, lower, upper) if near.size else None
    if fault is not None:
        raise fault


def first_excess(
    context: PlanContext, trajectory: PiecewisePolynomial, pieces: range, before: Array
) -> Generator[None, None, LimitError | None]:
    """Return the first place in some pieces with a velocity, acceleration or jerk beyond the limit, slice by slice.

    A jump of acceleration where a piece begins counts as a jerk within the time between evaluations.

    Args:
        context: Limits and joints.
        trajectory: To check.
        pieces: Which of its pieces; those that a coarse bound does not clear are looked at closely.
        before: Acceleration with which the first of them is begun, shape (n,).
    """
    limits = context.limits.motion.of(context.index)
    for begin in range(pieces.start, pieces.stop, _PIECES_CLEARED):
        some = slice(begin, min(begin + _PIECES_CLEARED, pieces.stop))
        faults = [_first_jump(context, trajectory, some, before, limits.jerk)]
        before = force_at_end(trajectory, slice(some.stop - 1, some.stop))[0]
        for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1):
            near = _not_cleared(trajectory, some, order, -limit, limit)
            for k in range(0, len(near), _PIECES_CLOSE):
                yield
                faults.append(_first_beyond(context, trajectory, near[k : k + _PIECES_CLOSE], order, -limit, limit))
                if faults[-1] is not None:
                    break
        found = min((f for f in faults if f is not None), key=_time_of, default=None)
        if found is not None:
            return found
        yield
    return None


def slowdown(trajectory: PiecewisePolynomial, limits: MotionLimits, pieces: slice) -> float:
    """Return the factor of time by which short pieces keep velocity, acceleration and jerk; 1 for good ones.

    Args:
        trajectory: To check.
        limits: Of its joints, each of shape (n,).
        pieces: Which of its pieces.
    """
    return max(1.0, float(excess(trajectory.coefficients[pieces], trajectory.lengths[pieces], limits).max()))


def excess(coefficients: Array, lengths: Array, limits: MotionLimits) -> Array:
    """Return for each of m short pieces the factor of time within the limits, below 1 if the piece may be quicker.

    Args:
        coefficients: Of the pieces, shape (m, 6, n).
        lengths: Shape (m,) [s].
        limits: Of its joints, each of shape (n,).
    """
    factor = np.zeros(len(lengths))
    for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1):
        used = np.abs(_values(coefficients, lengths, order, _SAMPLES_OF_SHORT)).max(axis=1) / limit
        factor = np.maximum(factor, used.max(axis=1) ** (1.0 / order))
    return factor


def _not_cleared(
    trajectory: PiecewisePolynomial, pieces: slice, order: int, lower: Array, upper: Array
) -> NDArray[np.intp]:
    """Return pieces not proved within a limit by Bernstein's coefficients, which enclose a polynomial."""
    lengths = trajectory.lengths[pieces]
    scale = lengths[:, None] ** np.maximum(np.arange(6) - order, 0)
    bounds = np.matmul(_bernstein(order), trajectory.coefficients[pieces] * scale[:, :, None])
    cleared = ((bounds >= lower) & (bounds <= upper)).all(axis=(1, 2))
    return np.asarray(np.arange(len(trajectory.lengths))[pieces][~cleared])


def _first_beyond(
    context: PlanContext,
    trajectory: PiecewisePolynomial,
    pieces: NDArray[np.intp],
    order: int,
    lower: Array,
    upper: Array,
) -> LimitError | None:
    slack = _TOLERANCE * (upper - lower) / (2.0 if order else 1.0)
    values = _values(trajectory.coefficients[pieces], trajectory.lengths[pieces], order, _SAMPLES)
    beyond = ~((values >= lower - slack) & (values <= upper + slack))
    if not beyond.any():
        return None
    piece, sample, k = (int(i) for i in np.argwhere(beyond)[0])
    share = sample / (_SAMPLES - 1)
    time = float(trajectory.edges[pieces[piece]] + trajectory.lengths[pieces[piece]] * share)
    value = float(values[piece, sample, k])
    limit = float((lower if value < lower[k] else upper)[k])
    return _fault(context, k, order, value, limit, f"at {time:.3f} s of the trajectory", time)


def _first_jump(
    context: PlanContext, trajectory: PiecewisePolynomial, pieces: slice, before: Array, limit: Array
) -> LimitError | None:
    """The first jump of acceleration with which one of some pieces begins, or the whole ends."""
    ends = force_at_end(trajectory, pieces)
    jumps = 2.0 * trajectory.coefficients[pieces, 2] - np.vstack([before, ends[:-1]])
    times = trajectory.edges[pieces]
    if pieces.stop == len(trajectory.lengths):
        jumps, times = np.vstack([jumps, -ends[-1]]), np.append(times, trajectory.duration)
    jerk = jumps / context.period_s
    beyond = ~(np.abs(jerk) <= _JUMP * limit)
    if not beyond.any():
        return None
    rank, k = (int(i) for i in np.argwhere(beyond)[0])
    time, value = float(times[rank]), float(jerk[rank, k])
    where = f"at {time:.3f} s of the trajectory, where its acceleration jumps by {jumps[rank, k]:.6g},"
    return _fault(context, k, 3, value, float(np.copysign(limit[k], value)), where, time)


def force_at_end(trajectory: PiecewisePolynomial, pieces: slice) -> Array:
    """Return the accelerations at the ends of some pieces, shape (m, n)."""
    return np.asarray(_values(trajectory.coefficients[pieces], trajectory.lengths[pieces], 2, 2)[:, 1])


def _time_of(fault: LimitError) -> float:
    return float(str(fault.facts["time"]))


def _fault(context: PlanContext, k: int, order: int, value: float, limit: float, where: str, time: float) -> LimitError:
    i = context.index[k]
    name, unit = _NAMES[order]
    fault = LimitError(
        joint=context.limits.names[i],
        value=value,
        limit=limit,
        unit=context.limits.units[i] + unit,
        what=f"{name} {where}",
    )
    fault.facts["time"], fault.facts["quantity"] = time, name
    return fault


def _values(coefficients: Array, lengths: Array, order: int, samples: int) -> Array:
    """Return a derivative of m pieces at the ends and evenly between: shape (m, samples, n)."""
    scale = lengths[:, None] ** np.maximum(np.arange(6) - order, 0)
    return np.asarray(np.matmul(_basis(order, samples), coefficients * scale[:, :, None]))


@cache
def _basis(order: int, samples: int) -> Array:
    """Return derivatives of the powers of a time from 0 to 1, shape (samples, 6)."""
    powers = np.arange(6)
    factor = np.prod([powers - k for k in range(order)], axis=0)
    return np.asarray(factor * np.linspace(0.0, 1.0, samples)[:, None] ** np.maximum(powers - order, 0))


@cache
def _bernstein(order: int) -> Array:
    """From the powers of a time from 0 to 1 to Bernstein's coefficients of a derivative, shape (6 - order, 6)."""
    degree = 5 - order
    factor = np.prod([np.arange(6) - k for k in range(order)], axis=0)
    rows = [
        [comb(i, p - order) / comb(degree, p - order) if 0 <= p - order <= i else 0.0 for p in range(6)]
        for i in range(degree + 1)
    ]
    return np.asarray(factor * np.array(rows))
