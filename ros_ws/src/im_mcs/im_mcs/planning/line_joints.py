"""Joint positions over the parameter of a path."""

import numpy as np
from numpy.typing import NDArray


class JointCurve:
    """Joint positions over a path parameter: quintics through places with two derivatives.

    Args:
        s: Path parameter of the places, strictly increasing, shape (m + 1,) [m].
        coefficients: Ascending powers of the parameter since the place before, shape (m, 6, n).
    """

    def __init__(self, s: NDArray[np.float64], coefficients: NDArray[np.float64]) -> None:
        self._s = s
        self._coefficients = coefficients

    def at(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Value and three derivatives at ``s``, shape (m,): shape (4, m, n)."""
        i = np.clip(np.searchsorted(self._s, s, side="right") - 1, 0, len(self._coefficients) - 1)
        x, c = (s - self._s[i])[:, None], self._coefficients[i]
        c0, c1, c2, c3, c4, c5 = (c[:, k] for k in range(6))
        return np.stack(
            [
                c0 + x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * c5)))),
                c1 + x * (2.0 * c2 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5))),
                2.0 * c2 + x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5)),
                6.0 * c3 + x * (24.0 * c4 + x * 60.0 * c5),
            ]
        )
