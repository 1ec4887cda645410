"""The box in which the cell works, and in which errors of calibrated cameras are given."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Workspace:
    """Axis-parallel box in the world.

    Attributes:
        low: Lower corner [m].
        high: Upper corner [m].
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def __post_init__(self) -> None:
        """Check the corners.

        Raises:
            DataError: A side is not longer than zero.
        """
        if not all(a < b for a, b in zip(self.low, self.high, strict=True)):
            raise DataError(f"The workspace from {self.low} to {self.high} m has a side that is not longer than zero.")

    def moved(self, by: Array) -> "Workspace":
        """The box moved by ``by``, shape (3,) [m]."""
        low, high = (tuple(float(a + b) for a, b in zip(corner, by, strict=True)) for corner in (self.low, self.high))
        return Workspace((low[0], low[1], low[2]), (high[0], high[1], high[2]))

    def grid(self, counts: tuple[int, int, int] = (10, 5, 5)) -> Array:
        """Return the centres of equal cells; a mean over the centres is a mean over the volume.

        Args:
            counts: Number of cells along each axis.

        Returns:
            Points, shape (counts[0] * counts[1] * counts[2], 3) [m].

        >>> Workspace((-1.0, -0.5, 0.6), (1.0, 0.5, 1.6)).grid((2, 1, 1)).tolist()
        [[-0.5, 0.0, 1.1], [0.5, 0.0, 1.1]]
        """
        axes = [a + (b - a) * (np.arange(n) + 0.5) / n for a, b, n in zip(self.low, self.high, counts, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def box_around(positions: Array) -> Workspace:
    """Return the box of most positions, shape (n, 3) [m]: errors are predicted where data are.

    Raises:
        DataError: There is no position of finite numbers.

    >>> box_around(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 2.0]])).high
    (0.97, 0.001, 1.97)
    """
    finite = positions[np.isfinite(positions).all(axis=1)]
    if not len(finite):
        raise DataError("A calibration needs poses, none is given.")
    low, high = np.quantile(finite, (0.03, 0.97), axis=0)
    high = np.maximum(high, low + np.maximum(1e-3, 1e-12 * np.abs(low)))
    (a, b, c), (x, y, z) = low.tolist(), high.tolist()
    return Workspace((a, b, c), (x, y, z))
