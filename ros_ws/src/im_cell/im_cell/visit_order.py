"""Order of positions by the time of all motions: the nearest next, then better by exchange.

Parts of the order are turned round, and short ones moved, while that saves time. Source: G.A. Croes, "A method for
solving traveling-salesman problems", Operations Research 1958 (2-opt); I. Or, dissertation, Northwestern University
1976 (Or-opt).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from im_cell.motion_time import motion_times
from im_cell.robot import Cell

Array = NDArray[np.float64]

#: A straight way that is blocked counts as so much longer [s]: others come first.
BLOCKED_S = 30.0
#: Longest part of the order that is moved elsewhere, and savings that are rounding [s].
_LONGEST_PART, _ROUNDING_S = 3, 1e-9


def leg_times(cell: Cell, joints: list[str], positions: ArrayLike) -> Array:
    """Return times of the straight motions between any two of m positions, shape (m, m) [s]."""
    places = np.array(positions)
    return motion_times(cell, joints, places[:, None] - places[None])


def visit_order(times: Array) -> list[int]:
    """Return ranks of all positions in a short order, the start with rank 0 first.

    Args:
        times: Of the motions between any two, the same there and back, shape (m, m) [s].
    """
    order, left = [0], list(range(1, len(times)))
    while left:
        order.append(min(left, key=lambda rank: (times[order[-1], rank], rank)))
        left.remove(order[-1])
    found = np.array(order)
    while _turned(found, times) or _moved(found, times):
        pass
    return [int(rank) for rank in found]


def _turned(order: NDArray[np.intp], times: Array) -> bool:
    """Turn parts of the order round, in place, to save time; return success."""
    success = False
    for first in range(1, len(order) - 1):
        before, begin, ends, after = order[first - 1], order[first], order[first + 1 :], order[first + 2 :]
        saved = times[before, begin] - times[before, ends]
        saved[:-1] += times[ends[:-1], after] - times[begin, after]
        best = int(np.argmax(saved))
        if saved[best] > _ROUNDING_S:
            last = first + 1 + best
            order[first : last + 1] = order[first : last + 1][::-1].copy()
            success = True
    return success


def _moved(order: NDArray[np.intp], times: Array) -> bool:
    """Move short parts of the order elsewhere, in place, to save time; return success."""
    success = False
    for length in range(1, _LONGEST_PART + 1):
        for first in range(1, len(order) - length + 1):
            part, rest = order[first : first + length].copy(), np.delete(order, slice(first, first + length))
            without = _length(order, times) - _length(rest, times)
            for way in (part, part[::-1]):
                added = times[rest, way[0]]
                added[:-1] += times[way[-1], rest[1:]] - times[rest[:-1], rest[1:]]
                best = int(np.argmin(added))
                if without - _length(part, times) - added[best] > _ROUNDING_S:
                    order[:] = np.insert(rest, best + 1, way)
                    success = True
                    break
    return success


def _length(order: NDArray[np.intp], times: Array) -> float:
    return float(times[order[:-1], order[1:]].sum())
