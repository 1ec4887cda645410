"""Values of one per joint in requests, and sentences about what is wrong with them."""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, LimitError
from im_mcs.planning.values import as_list, as_numbers

if TYPE_CHECKING:
    from im_mcs.planning.context import PlanContext

_ROUNDING = 1e-6


def per_joint(context: "PlanContext", values: object, what: str) -> NDArray[np.float64] | None:
    """Finite values, shape (n,), or None for an empty list.

    Raises:
        DataError: Not as many as joints, or one is not finite.
    """
    numbers = as_numbers(values, what)
    if not numbers:
        return None
    names = [context.limits.names[i] for i in context.index]
    if len(numbers) != len(names):
        raise DataError(f"{what}: {len(numbers)} values for {len(names)} joints ({', '.join(names)})")
    for name, number in zip(names, numbers, strict=True):
        if not math.isfinite(number):
            raise DataError(f"{what}: {name}: {number} is not a finite number", joint=name)
    return np.array(numbers, dtype=np.float64)


def within(
    context: "PlanContext", values: NDArray[np.float64], limit: NDArray[np.float64], what: str, unit: str
) -> None:
    """Check values, shape (n,), against limits, shape (n,); ``unit`` is what follows that of the position.

    Raises:
        LimitError: One is beyond.
    """
    beyond = np.abs(values) > limit * (1.0 + _ROUNDING)
    if beyond.any():
        k = int(np.argmax(beyond))
        i = context.index[k]
        unit = context.limits.units[i] + unit
        raise LimitError(
            joint=context.limits.names[i], value=float(values[k]), limit=float(limit[k]), unit=unit, what=what
        )


def check_points(context: "PlanContext", points: object) -> NDArray[np.float64]:
    """Positions of the points of a path, shape (m, n).

    Raises:
        DataError: None or too many, not one value per joint, or one that is not finite.
        LimitError: A position is out of its joint's range.
    """
    given = as_list(points, "points")
    most = context.config.planning.max_points
    if not 1 <= len(given) <= most:
        raise DataError(f"a path of {len(given)} points is not one of 1 to {most}", points=len(given))
    limits, index = context.limits, context.index
    sizes = all(isinstance(point, list) and len(point) == len(index) for point in given)
    if sizes and all(type(value) is float for point in given for value in point):
        q = np.array(given, dtype=np.float64)
        if ((q >= limits.lower[index]) & (q <= limits.upper[index])).all():
            return q
    # something is wrong: find out what
    return np.array(
        [
            limits.check_positions(index, as_numbers(point, f"point {number}"), f"point {number}")
            for number, point in enumerate(given, start=1)
        ]
    )
