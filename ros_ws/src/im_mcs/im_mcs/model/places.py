"""Where the joints of a group are among all joints."""

import numpy as np
from numpy.typing import NDArray

Place = slice | NDArray[np.intp]


def place_of(index: NDArray[np.intp]) -> Place:
    """Ranks of joints, shape (n,), as a slice if they are neighbours: numpy writes there several times quicker."""
    first, count = int(index[0]), len(index)
    return slice(first, first + count) if np.array_equal(index, np.arange(first, first + count)) else index
