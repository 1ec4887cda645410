"""Whether a whole trajectory keeps to the limits, judged before anything moves, on a grid finer than the servo's."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from im_core.errors import LimitError
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.context import PlanContext
from im_mcs.planning.polynomial import PiecewisePolynomial

# of one piece, both ends included: what is given as points in time has long pieces, a fitted line pieces of 20 ms
_SAMPLES, _SAMPLES_OF_SHORT = 257, 9
_TOLERANCE = 1e-4
_NAMES = (("position", ""), ("velocity", "/s"), ("acceleration", "/s2"))


def check_envelope(
    context: PlanContext,
    trajectory: PiecewisePolynomial,
    pieces: slice = slice(None),
    *,
    positions_only: bool = False,
) -> None:
    """Check position, velocity and acceleration of every piece, at its ends and evenly between.

    Args:
        context: Limits and joints.
        trajectory: To check.
        pieces: Which of its pieces.
        positions_only: Velocity and acceleration are known to be within limits.

    Raises:
        LimitError: One is not; names joint, value, limit, unit and time.
    """
    lengths, coefficients = trajectory.lengths[pieces], trajectory.coefficients[pieces]
    limits, index = context.limits, context.index
    motion = limits.motion.of(index)
    lower, upper = limits.lower[index], limits.upper[index]
    slack = _TOLERANCE * (upper - lower)
    bounds = [
        (lower - slack, upper + slack),
        (-motion.velocity * (1.0 + _TOLERANCE), motion.velocity * (1.0 + _TOLERANCE)),
        (-motion.acceleration * (1.0 + _TOLERANCE), motion.acceleration * (1.0 + _TOLERANCE)),
    ]
    for order, (low, high) in enumerate(bounds[: 1 if positions_only else 3]):
        values = _values(coefficients, lengths, order, _SAMPLES)
        beyond = (values < low) | (values > high)
        if beyond.any():
            # the first in time
            piece, sample, k = (int(i) for i in np.argwhere(beyond)[0])
            end, share = float(trajectory.lengths.cumsum()[pieces][piece]), sample / (_SAMPLES - 1)
            time = end - float(lengths[piece]) * (1.0 - share)
            value = float(values[piece, sample, k])
            name, unit = _NAMES[order]
            i = index[k]
            limit = (lower if value < low[k] else upper)[k] if order == 0 else np.sign(value) * high[k]
            fault = LimitError(
                joint=limits.names[i],
                value=value,
                limit=float(limit),
                unit=limits.units[i] + unit,
                what=f"{name} at {time:.3f} s of the trajectory",
            )
            fault.facts["time"] = time
            raise fault


def slowdown(trajectory: PiecewisePolynomial, limits: MotionLimits, pieces: slice) -> float:
    """Factor by which short pieces must take longer to keep velocity, acceleration and jerk; 1 if they do.

    Args:
        trajectory: To check.
        limits: Of its joints, each of shape (n,).
        pieces: Which of its pieces.
    """
    lengths, coefficients = trajectory.lengths[pieces], trajectory.coefficients[pieces]
    factor = 1.0
    for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1):
        used = np.abs(_values(coefficients, lengths, order, _SAMPLES_OF_SHORT)).max(axis=(0, 1)) / limit
        factor = max(factor, float(used.max()) ** (1.0 / order))
    return factor


def _values(
    coefficients: NDArray[np.float64], lengths: NDArray[np.float64], order: int, samples: int
) -> NDArray[np.float64]:
    """Derivative of some order of m pieces at their ends and evenly between: shape (m, samples, n)."""
    scale = lengths[:, None] ** np.maximum(np.arange(6) - order, 0)
    return np.asarray(np.matmul(_basis(order, samples), coefficients * scale[:, :, None]))


@cache
def _basis(order: int, samples: int) -> NDArray[np.float64]:
    """Derivatives of the powers of a time from 0 to 1, shape (samples, 6)."""
    powers = np.arange(6)
    factor = np.prod([powers - k for k in range(order)], axis=0)
    return np.asarray(factor * np.linspace(0.0, 1.0, samples)[:, None] ** np.maximum(powers - order, 0))
