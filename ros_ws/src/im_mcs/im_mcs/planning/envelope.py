"""Whether a whole trajectory keeps to the limits, judged before anything moves."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from im_core.errors import LimitError
from im_mcs.planning.polynomial import PiecewisePolynomial

if TYPE_CHECKING:
    from im_mcs.planning.context import PlanContext

_SAMPLES = 33
_TOLERANCE = 1e-4
_NAMES = (("position", ""), ("velocity", "/s"), ("acceleration", "/s2"))


def check_envelope(
    context: "PlanContext",
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
    share = np.linspace(0.0, 1.0, _SAMPLES)
    lengths = trajectory.lengths[pieces]
    x = lengths[:, None] * share
    coefficients = trajectory.coefficients[pieces]
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
        values = _values(coefficients, x, order)
        beyond = (values < low) | (values > high)
        if beyond.any():
            # the first in time
            piece, sample, k = (int(i) for i in np.argwhere(beyond)[0])
            begin = float(trajectory.lengths.cumsum()[pieces][piece] - lengths[piece])
            value = float(values[piece, sample, k])
            name, unit = _NAMES[order]
            i = index[k]
            limit = (lower if value < low[k] else upper)[k] if order == 0 else np.sign(value) * high[k]
            fault = LimitError(
                joint=limits.names[i],
                value=value,
                limit=float(limit),
                unit=limits.units[i] + unit,
                what=f"{name} at {begin + float(x[piece, sample]):.3f} s of the trajectory",
            )
            fault.facts["time"] = begin + float(x[piece, sample])
            raise fault


def _values(coefficients: NDArray[np.float64], x: NDArray[np.float64], order: int) -> NDArray[np.float64]:
    """Derivative of some order at local times ``x``, shape (m, s): shape (m, s, n)."""
    powers = np.arange(6)
    factor = {0: np.ones(6), 1: powers, 2: powers * (powers - 1)}[order]
    rows = factor * x[:, :, None] ** np.maximum(powers - order, 0)
    return np.asarray(np.matmul(rows, coefficients))
