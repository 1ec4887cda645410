"""How evenly lights fill a space, and how much the wrist turns between them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree


@dataclass(frozen=True)
class Spread:
    """Measures of a set of poses.

    Attributes:
        nearest_m: Least distance between two lights [m].
        hole_m: Largest distance of a usable place from the nearest light: the dispersion of the set [m].
        turning: Least variance of the direction of an axis of the wrist, over all axes fixed to the wrist: 0 if the
            wrist turns about one axis or not at all, so that an offset along it cannot be seen; 1 for orientations
            spread over all rotations.
    """

    nearest_m: float
    hole_m: float
    turning: float


def spread_of(lights: NDArray[np.float64], wrists: NDArray[np.float64], usable: NDArray[np.float64]) -> Spread:
    """Measure a set of poses.

    Args:
        lights: Positions of the light, shape (n, 3) [m].
        wrists: Rotations of the wrist, shape (n, 3, 3).
        usable: Places that could have been chosen, shape (m, 3) [m].
    """
    tree = cKDTree(lights)
    between = tree.query(lights, k=2)[0][:, 1] if len(lights) > 1 else np.array([np.inf])
    largest_mean = np.linalg.svd(wrists.mean(axis=0), compute_uv=False)[0]
    return Spread(float(between.min()), float(tree.query(usable)[0].max()), float(1.0 - largest_mean**2))


def farthest_first(points: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """Ranks of points, shape (count,): the innermost, then always the farthest from those before (Gonzalez, 1985).

    They leave holes at most twice as large as the best choice would.

    Args:
        points: Shape (n, 3), n >= count [m].
        count: How many.
    """
    first = int(np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1)))
    order, distance = [first], np.linalg.norm(points - points[first], axis=1)
    while len(order) < count:
        order.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[order[-1]], axis=1))
    return np.array(order, dtype=np.intp)
