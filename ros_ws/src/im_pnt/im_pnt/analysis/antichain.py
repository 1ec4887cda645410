"""The largest vectors of a growing set, with fast tests against all of them at once."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


class Antichain:
    """Vectors of which none covers another; each has the number of its owner.

    Args:
        size: Length of the vectors; their components are below 2**53 or infinite.
    """

    def __init__(self, size: int) -> None:
        self._columns = np.zeros((size, 64))
        self._owners = np.zeros(64, np.int64)
        self._count = 0

    def covers(self, vector: Sequence[float]) -> bool:
        """Whether a vector is at most as large as one of the set, in every component."""
        rows: NDArray[np.intp] = np.arange(self._count)
        for component, value in enumerate(vector):
            if value > 0 and rows.size:
                rows = rows[self._columns[component][rows] >= value]
        return rows.size > 0

    def add(self, vector: Sequence[float], owner: int) -> list[int]:
        """Adds a vector that the set does not cover. Returns the owners of those that it covers, which leave."""
        rows = np.arange(self._count)
        for component, value in enumerate(vector):
            if value != np.inf and rows.size:
                rows = rows[self._columns[component][rows] <= value]
        covered = [int(self._owners[row]) for row in rows]
        for row in rows[::-1]:
            self._count -= 1
            self._columns[:, row] = self._columns[:, self._count]
            self._owners[row] = self._owners[self._count]
        if self._count == self._columns.shape[1]:
            self._columns = np.concatenate([self._columns, np.zeros_like(self._columns)], axis=1)
            self._owners = np.concatenate([self._owners, np.zeros_like(self._owners)])
        self._columns[:, self._count] = vector
        self._owners[self._count] = owner
        self._count += 1
        return covered
