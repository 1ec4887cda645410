"""Smooth error of an arm: constant in time, and alike at neighbouring places.

An arm repeats a position far better than it knows it. Where its kinematics are given, its error is mostly that of
joints that are turned and shifted a little from where the drawing has them; beneath, and where they are not given, it
is a polynomial of third order of the place, and of first order of the wrist's rotation, with random coefficients: a
random field of few terms. Terms that shift or turn all positions alike are left out: the frame of the cameras is the
one that the arm's readings have as a whole.
Sources: Rasmussen and Williams, "Gaussian Processes for Machine Learning" (2006), sections 2.7 and 4.2; B. Mooring,
Z. Roth, M. Driels, "Fundamentals of Manipulator Calibration" (1991), chapter 3.
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
LARGEST_SHIFT_M, LARGEST_TURN_RAD = 3e-3, 6e-3
"""Largest standard deviation of a reading of a link's pose, of each coordinate [m] and about each axis [rad]."""

_SHARES = {1: 1.0, 2: 1.0, 3: 0.5}
"""Size of the terms of each order, of one another."""
_WRIST_SHARE = 0.6
"""Size of the terms of the wrist's rotation, likewise: its joints are off as well, and the tool swings on them."""
_KEPT = 2e-3
"""Least size of a combination of errors that counts, of the largest [-]."""
_BENEATH = 0.1
"""Size of the polynomial beneath the error of kinematics that are given, of that error."""


@dataclass(frozen=True)
class ArmError:
    """Smooth error of an arm at n positions, linear in k unknown coefficients of unit standard deviation.

    Attributes:
        jacobians: Derivatives of the positions by the coefficients, shape (n, 3, k) [m].
        kinds: Kind of error that each coefficient is of; each kind has a size of its own, shape (k,).
    """

    jacobians: Array
    kinds: NDArray[np.intp]

    @staticmethod
    def largest(positions: Array, wrists: Array, kinematics: Array | None = None) -> "ArmError":
        """Return the largest error of an arm.

        Args:
            positions: Where it goes, shape (n, 3) [m].
            wrists: Rotations of its wrist there, shape (n, 3, 3).
            kinematics: Derivatives of them by errors of its kinematics, each of its usual size, shape (n, 3, m) [m].
        """
        away = positions - positions.mean(axis=0)
        extent = max(float(np.sqrt((away**2).sum(axis=1).mean())), 1e-300)
        away = away / extent
        turned = np.stack([cross_matrix(place) for place in away])
        rigid = np.concatenate((np.tile(np.eye(3), (len(away), 1, 1)), turned), axis=2).reshape(-1, 6)
        axes = np.linalg.svd(rigid, full_matrices=False)[0]
        blocks = []

        def add(share: float, block: Array) -> None:
            block = block - axes @ (axes.T @ block)
            blocks.append(share * block / max(float(np.linalg.norm(block)), 1e-300))

        if kinematics is not None:
            add(1.0, kinematics.reshape(len(rigid), -1))
        for order, share in _SHARES.items():
            terms = _powers(away, order)
            beneath = 1.0 if kinematics is None else _BENEATH
            add(beneath * share, np.einsum("nk,ij->nikj", terms, np.eye(3)).reshape(len(rigid), -1))
        if kinematics is None:
            terms = (wrists - wrists.mean(axis=0)).reshape(len(away), 9)
            add(_WRIST_SHARE, np.einsum("nk,ij->nikj", terms, np.eye(3)).reshape(len(rigid), -1))
        left, values, _ = np.linalg.svd(np.concatenate(blocks, axis=1), full_matrices=False)
        whole = (left * values)[:, values > _KEPT * values[0]]  # many terms do nearly the same
        whole = whole * (LARGEST_SHARE * extent * np.sqrt(len(rigid)) / max(float(np.linalg.norm(whole)), 1e-300))
        return ArmError(whole.reshape(len(away), 3, -1), np.zeros(whole.shape[1], dtype=np.intp))

    @staticmethod
    def of_readings(poses: Array, of: NDArray[np.intp], levers: Array) -> "ArmError":
        """Return the largest error of an arm whose readings say where a target is; its kinds are shifts and turns.

        Nothing is left out: what shifts or turns all readings alike is an error of the places of camera and target.

        Args:
            poses: Readings of the link's pose in the base, shape (r, 4, 4).
            of: Which of them each position is of, shape (n,).
            levers: Derivatives of the positions by a shift and a turn of the link, shape (n, 3, 6) [-], [m].
        """
        away, wrists = poses[:, :3, 3] - poses[:, :3, 3].mean(axis=0), poses[:, :3, :3]
        away = away / max(float(np.sqrt((away**2).sum(axis=1).mean())), 1e-300)
        blocks = [(share, _powers(away, order)) for order, share in ({0: 1.0} | _SHARES).items()]
        turned = (wrists - wrists.mean(axis=0)).reshape(len(poses), 9)
        blocks += [(1.0, turned), (1.0, np.einsum("ni,nj->nij", away, turned).reshape(len(poses), 27))]
        terms = [share * block / max(float(np.linalg.norm(block)), 1e-300) for share, block in blocks]
        left, values, _ = np.linalg.svd(np.concatenate(terms, axis=1), full_matrices=False)
        kept = (left * values)[:, values > _KEPT * values[0]]
        kept = np.sqrt(len(poses)) / np.linalg.norm(kept) * kept
        jacobians = [
            size * np.einsum("nk,nij->nikj", kept[of], lever).reshape(len(of), 3, -1)
            for size, lever in ((LARGEST_SHIFT_M, levers[..., :3]), (LARGEST_TURN_RAD, levers[..., 3:]))
        ]
        return ArmError(np.concatenate(jacobians, axis=2), np.repeat([0, 1], 3 * kept.shape[1]))

    @property
    def standard_deviation(self) -> float:
        """Standard deviation of a coordinate, RMS over the positions [m]."""
        return float(np.sqrt((self.jacobians**2).sum(axis=2).mean()))

    @property
    def sizes(self) -> Array:
        """The part of each kind in the standard deviation, shape (kinds,) [m]."""
        each = (self.jacobians[:, :, self.kinds == kind] for kind in range(self.kinds.max() + 1))
        return np.array([np.sqrt((jacobians**2).sum(axis=2).mean()) for jacobians in each])

    def times(self, factors: Array) -> "ArmError":
        """Return an error of other sizes, given a factor of each kind."""
        return replace(self, jacobians=factors[self.kinds] * self.jacobians)

    def taking(self, poses: NDArray[np.intp]) -> "ArmError":
        """Return the same error at some of the positions."""
        return replace(self, jacobians=self.jacobians[poses])


def _powers(away: Array, order: int) -> Array:
    """Return all products of as many coordinates as the order, turned with the axes, shape (n, 3) -> (n, k)."""
    powers = list(combinations_with_replacement(range(3), order))
    counts = [factorial(order) / np.prod([factorial(power.count(i)) for i in range(3)]) for power in powers]
    return np.stack([np.prod(away[:, list(power)], axis=1) for power in powers], axis=1) * np.sqrt(counts)
