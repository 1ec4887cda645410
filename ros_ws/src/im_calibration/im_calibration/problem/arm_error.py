"""Smooth error of an arm: constant in time, and alike at neighbouring places.

An arm repeats a position far better than it knows it: its error is a function of its joints, thus of the place of the
light and the turn of the wrist. Here that function is a polynomial of third order in the place, and of first order in
the wrist's rotation, with random coefficients: a random field of few terms. Terms that shift or turn all positions
alike are left out: the frame of the cameras is the one that the arm's readings have as a whole. Source: Rasmussen and
Williams, "Gaussian Processes for Machine Learning" (2006), sections 2.7 and 4.2.
"""

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from math import factorial

import numpy as np
from numpy.typing import NDArray

from im_cell.rotations import cross_matrix

Array = NDArray[np.float64]

LARGEST_SHARE = 4e-3
"""Largest standard deviation of each coordinate of an arm's error, as a share of the extent of its positions [-]."""

WRIST_SHARES = (0.0, 0.25, 0.8)
"""Sizes that the terms of the wrist may have, of the terms of second order."""

_SHARES = {1: 1.4, 2: 1.0, 3: 0.45}
"""Size of the terms of each order, of one another, as wrong links, zeros and gears of arms of six joints have them. No
residual shows the first order, for a camera takes it up; so that it is known by the others alone."""


@dataclass(frozen=True)
class ArmError:
    """Smooth error of an arm at n positions, linear in k unknown coefficients of unit standard deviation.

    Attributes:
        jacobians: Derivatives of the positions by the coefficients, shape (n, 3, k) [m].
    """

    jacobians: Array

    @staticmethod
    def largest(positions: Array, wrists: Array, wrist_share: float) -> "ArmError":
        """Return the largest error of an arm.

        Args:
            positions: Where it goes, shape (n, 3) [m].
            wrists: Rotations wrist -> base there, shape (n, 3, 3).
            wrist_share: Size of the terms of the wrist, see :data:`WRIST_SHARES`.
        """
        away = positions - positions.mean(axis=0)
        extent = max(float(np.sqrt((away**2).sum(axis=1).mean())), 1e-300)
        away = away / extent
        turned = np.stack([cross_matrix(place) for place in away])
        rigid = np.concatenate((np.tile(np.eye(3), (len(away), 1, 1)), turned), axis=2).reshape(-1, 6)
        axes = np.linalg.svd(rigid, full_matrices=False)[0]
        fields = [(wrist_share, wrists.reshape(-1, 9) - wrists.reshape(-1, 9).mean(axis=0))] * (wrist_share > 0.0)
        for order, share in _SHARES.items():
            powers = list(combinations_with_replacement(range(3), order))
            counts = [factorial(order) / np.prod([factorial(power.count(i)) for i in range(3)]) for power in powers]
            terms = np.stack([np.prod(away[:, list(power)], axis=1) for power in powers], axis=1)
            fields.append((share, terms * np.sqrt(counts)))
        blocks = []
        for share, terms in fields:
            block = np.einsum("nk,ij->nikj", terms, np.eye(3)).reshape(len(rigid), -1)
            block = block - axes @ (axes.T @ block)
            blocks.append(share * block / max(float(np.linalg.norm(block)), 1e-9))
        whole = np.concatenate(blocks, axis=1)
        whole = whole * (LARGEST_SHARE * extent * np.sqrt(len(rigid)) / max(float(np.linalg.norm(whole)), 1e-300))
        return ArmError(whole.reshape(len(away), 3, -1))

    @property
    def standard_deviation(self) -> float:
        """Standard deviation of a coordinate, RMS over the positions [m]."""
        return float(np.sqrt((self.jacobians**2).sum(axis=2).mean()))

    def times(self, factor: float) -> "ArmError":
        """Return an error of another size."""
        return replace(self, jacobians=factor * self.jacobians)

    def taking(self, poses: NDArray[np.intp]) -> "ArmError":
        """Return the same error at some of the positions."""
        return replace(self, jacobians=self.jacobians[poses])
