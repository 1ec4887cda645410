"""A few numbers at a time, compiled: for some, numpy's checks take ten times as long as the work."""

import numpy as np
from numpy.typing import NDArray

def all_finite(x: NDArray[np.float64]) -> bool:
    """Return whether every number of ``x``, shape (n,), is finite."""

def any_beyond(x: NDArray[np.float64], bounds: NDArray[np.float64]) -> bool:
    """Return whether the size of any number of ``x`` is beyond its bound, shape (n,) each; never of NaN.

    Raises:
        ValueError: They are not as many.
    """

def clip(x: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """Clip as :func:`numpy.clip`, shape (n,) each.

    Raises:
        ValueError: They are not as many.
    """
