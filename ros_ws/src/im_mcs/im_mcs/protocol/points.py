"""Points in time on the way to the servo: few as JSON, many in separate shared memory."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, ImError
from im_core.shm import SharedBlock


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


def share_points(name: str, points: TimedPoints) -> tuple[SharedBlock, dict[str, Any]]:
    """Put points into shared memory.

    Args:
        name: Of the memory.
        points: The points.

    Returns:
        The memory, which the caller closes when the motion has ended, and what stands for the points in a request.

    Raises:
        LinkError: Another process owns memory of that name.
    """
    columns = [points.times, *(x for x in (points.q, points.v, points.a) if x is not None)]
    block = SharedBlock.create(name, sum(column.nbytes for column in columns))
    end = 0
    for column in columns:
        block.array("<f8", column.size, 8 * end)[:] = column.ravel()
        end += column.size
    block.publish()
    has = {"velocities": points.v is not None, "accelerations": points.a is not None}
    return block, {"memory": name, "points": len(points.times), "joints": points.q.shape[1], **has}


def shared_points(given: Mapping[str, Any], most: int | None) -> TimedPoints:
    """Return the points behind a reference in a request, located in shared memory.

    Args:
        given: As :func:`share_points` returns it.
        most: How many there may be.

    Raises:
        DataError: It stands for none, or for too many.
    """
    try:
        m, n = int(given["points"]), int(given["joints"])
        if not 1 <= m <= (m if most is None else most):
            raise DataError(f"a trajectory of {m} points is not one of 1 to {most}")
        block = SharedBlock.attach(str(given["memory"]), 0.0)
        there = [True, bool(given["velocities"]), bool(given["accelerations"])]
        flat = block.array("<f8", m + sum(there) * m * n)
    except (KeyError, TypeError, ValueError, ImError) as error:
        if isinstance(error, ImError):
            raise
        raise DataError(f"points: {error!r} is wrong with what stands for points in memory") from None
    rows = iter(flat[m:].reshape(-1, m, n))
    q, v, a = (next(rows) if has else None for has in there)
    assert q is not None
    return TimedPoints(flat[:m], q, v, a)
