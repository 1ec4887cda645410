"""Who is wrong where a pose does not fit: one camera's spot, or the robot's position that all cameras share."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FALSE_ALARM = 5e-4
"""Probability with which a gate rejects an honest pose."""

_AMBIGUOUS = 9.0
_FREE_POSITION = 1.0


@dataclass(frozen=True)
class Prediction:
    """Spots of n poses in c cameras as predicted without them.

    Attributes:
        errors: Measured minus predicted, shape (n, 2c) [px].
        covariances: Covariances of `errors`, shape (n, 2c, 2c) [px^2].
        by_point: Derivatives of the spots by the LED position, shape (n, 2c, 3) [px/m].
    """

    errors: Array
    covariances: Array
    by_point: Array

    def distance(self, pose: int, cameras: NDArray[np.intp], *, scale: float = 1.0, free: bool = False) -> float:
        """Squared Mahalanobis length of the errors of some cameras.

        Args:
            pose: Index of the pose.
            cameras: Indices of the cameras.
            scale: Factor on the covariance.
            free: Whether the LED may be anywhere, so that only contradictions between the cameras count.
        """
        rows = np.stack((2 * cameras, 2 * cameras + 1), axis=1).ravel()
        covariance = scale * self.covariances[pose][np.ix_(rows, rows)]
        if free:
            moved = self.by_point[pose][rows]
            covariance = covariance + _FREE_POSITION**2 * moved @ moved.T
        errors = self.errors[pose][rows]
        return float(errors @ np.linalg.solve(covariance, errors))


class Agreement:
    """Decides for each pose which cameras' spots agree with the prediction and with each other."""

    def __init__(self, prediction: Prediction, detected: Mask, scale: float) -> None:
        """Prepare the decision.

        Args:
            prediction: Spots as predicted from the other poses.
            detected: Which spots there are, shape (c, n).
            scale: Factor on all covariances.
        """
        self._prediction, self._detected, self._scale = prediction, detected, scale

    def cameras(self, pose: int) -> list[int]:
        """Cameras whose spots to use; empty where it cannot be told who is wrong.

        A camera is to blame only if the spots contradict each other wherever the LED was; if they do not, the robot's
        position may be wrong as well, and the whole pose goes.
        """
        seen = np.flatnonzero(self._detected[:, pose])
        if self._distance(pose, seen) <= _gate(2 * len(seen)):
            return [int(c) for c in seen]
        contradiction = self._prediction.distance(pose, seen, scale=self._scale, free=True)
        if len(seen) < 2 or contradiction <= _gate(2 * len(seen) - 3):
            return []
        for size in range(len(seen) - 1, 0, -1):
            sets = sorted((self._distance(pose, np.array(subset)), subset) for subset in combinations(seen, size))
            if sets[0][0] <= _gate(2 * size):
                ambiguous = len(sets) > 1 and sets[1][0] - sets[0][0] < _AMBIGUOUS
                return [] if ambiguous else [int(c) for c in sets[0][1]]
        return []

    def _distance(self, pose: int, cameras: NDArray[np.intp]) -> float:
        return self._prediction.distance(pose, cameras, scale=self._scale)


def _gate(dof: int) -> float:
    """Value that chi-square exceeds with probability :data:`FALSE_ALARM`."""
    return float(scipy.stats.chi2.isf(FALSE_ALARM, dof))
