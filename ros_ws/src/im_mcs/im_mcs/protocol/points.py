"""Points in time on the way to the servo, each column as bytes: lists of numbers would cost twenty ticks."""

import reprlib
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

_COLUMNS = ("times", "positions", "velocities", "accelerations")


@dataclass(frozen=True)
class TimedPoints:
    """Positions at times.

    Attributes:
        times: Strictly increasing, shape (m,) [s].
        q: Positions, shape (m, n).
        v: Velocities, shape (m, n), if they are given.
        a: Accelerations, shape (m, n), if they are given.
    """

    times: NDArray[np.float64]
    q: NDArray[np.float64]
    v: NDArray[np.float64] | None
    a: NDArray[np.float64] | None

    def since(self, first: int, delay_s: float) -> Self:
        """The points from one on, later by ``delay_s`` [s]."""
        v, a = (None if x is None else x[first:] for x in (self.v, self.a))
        return type(self)(self.times[first:] + delay_s, self.q[first:], v, a)


def pack_points(points: TimedPoints) -> dict[str, bytes]:
    """Write points as data of a request: each column as doubles, little end first, row by row; empty for None."""
    columns = (points.times, points.q, points.v, points.a)
    return {name: b"" if x is None else x.astype("<f8").tobytes() for name, x in zip(_COLUMNS, columns, strict=True)}


def unpack_points(given: Any) -> TimedPoints:
    """Read points that :func:`pack_points` wrote.

    Raises:
        ValueError: The data are not of that form, or a column does not have one row for each time.
    """
    try:
        if set(given) != set(_COLUMNS):
            raise ValueError
        times, q, *rows = (np.frombuffer(given[name], "<f8") for name in _COLUMNS)
        v, a = (x.reshape(len(times), -1) if x.size else None for x in rows)
        return TimedPoints(times, q.reshape(len(times), -1 if q.size else 0), v, a)
    except (TypeError, ValueError):
        columns = ", ".join(_COLUMNS)
        raise ValueError(f"points: {reprlib.repr(given)} is not {columns}, each doubles as bytes") from None


def packed_size(points: int, joints: int) -> int:
    """Compute how many bytes the columns of so many points of so many joints have at most."""
    return 8 * points * (1 + 3 * joints)
