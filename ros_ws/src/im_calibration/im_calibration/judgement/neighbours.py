"""Test of residuals for noise: noise of neighbouring positions is independent, errors left by a model are not.

Chi-square compares residuals with a noise that is stated. Where none is, their pattern still tells the two apart.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from im_calibration.estimation.residuals import Linearisation, camera_blocks

Mask = NDArray[np.bool_]

_NEIGHBOURS, _FEWEST_SPOTS = 4, 25
_CHANCE = 1e-5


@dataclass(frozen=True)
class Neighbours:
    """How alike the residuals of neighbouring positions are.

    Attributes:
        correlation: Of the residuals with those of the nearest positions; NaN with fewer than 25 spots a camera.
        limit: What noise exceeds with a chance of 1e-5.
    """

    correlation: float
    limit: float

    @property
    def alike(self) -> bool:
        """Whether neighbouring residuals are alike, thus no noise."""
        return self.correlation > self.limit

    @property
    def clause(self) -> str:
        """Clause on the likeness of neighbouring residuals; empty for noise."""
        if not self.alike:
            return ""
        return f"neighbouring spots are off alike (correlation {self.correlation:.2f}, of noise below {self.limit:.2f})"

    @property
    def remark(self) -> str:
        """Meaning of the likeness, in sentences; empty for noise."""
        if not self.alike:
            return ""
        return (
            f"The residuals are no noise: {self.clause}. Positions or lens are not as the model has them, and the "
            "cameras are known less well than stated: check the positions, or take a model of the lens with more terms."
        )


def compare_neighbours(line: Linearisation, used: Mask, positions: NDArray[np.float64]) -> Neighbours:
    """Correlate the residuals of each camera with the residuals of the nearest positions.

    Source: Moran, "Notes on continuous stochastic phenomena" (1950); the variance is that of independent residuals.

    Args:
        line: The problem at the estimate.
        used: Which spots count, shape (c, n).
        positions: Where the LED was, shape (n, 3) [m].
    """
    together, weight, variance = 0.0, 0.0, 0.0
    spread = camera_blocks(line.covariances)
    residuals = np.swapaxes(line.residuals.reshape(len(line.residuals), -1, 2), 0, 1)
    for c, counts in enumerate(used):
        if counts.sum() < _FEWEST_SPOTS:
            continue
        nearest = scipy.spatial.cKDTree(positions[counts]).query(positions[counts], _NEIGHBOURS + 1)[1][:, 1:]
        rows = np.repeat(np.arange(len(nearest)), _NEIGHBOURS)
        near = scipy.sparse.csr_array((np.ones(nearest.size), (rows, nearest.ravel())), shape=(len(nearest),) * 2)
        white = np.linalg.solve(np.linalg.cholesky(spread[c][counts]), residuals[c][counts][..., None])[..., 0]
        white = white / max(float(np.sqrt((white**2).mean())), 1e-300)
        together += float((white * (near @ white)).sum())
        weight += 2.0 * float(near.sum())
        variance += float((near + near.T).power(2).sum())
    if not weight:
        return Neighbours(float("nan"), float("nan"))
    return Neighbours(together / weight, -float(scipy.special.ndtri(_CHANCE)) * variance**0.5 / weight)
