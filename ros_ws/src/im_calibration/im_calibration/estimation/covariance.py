"""Covariance of all unknowns at the maximum of the likelihood (inverse of the Fisher information)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SINGULAR = 1e-13


@dataclass(frozen=True)
class Covariance:
    """Covariance of the unknowns.

    Attributes:
        matrix: Covariance, shape (size, size); directions without information have a very large, finite variance.
        null: Whether a parameter takes part in a direction without information, shape (size,).
    """

    matrix: Array
    null: NDArray[np.bool_]

    @property
    def standard_deviations(self) -> Array:
        """Standard deviation of each unknown, shape (size,)."""
        return np.asarray(np.sqrt(np.diag(self.matrix)))


def covariance_of(information: Array) -> Covariance:
    """Invert an information matrix, scaled to unit diagonal to make pixels, metres and radians comparable.

    Args:
        information: Normal matrix with priors, shape (size, size).
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information * scale[:, None] * scale[None, :])
    floor = _SINGULAR * values[-1]
    lost = vectors[:, values < floor]
    inverse = (vectors / np.maximum(values, floor)) @ vectors.T
    null = (np.abs(lost) > 0.05).any(axis=1) if lost.size else np.zeros(len(values), dtype=bool)
    return Covariance(inverse * scale[:, None] * scale[None, :], null)
