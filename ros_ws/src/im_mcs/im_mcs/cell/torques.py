"""Torques that arms of a cell take at full acceleration, next to those that the joints give."""

import numpy as np
from numpy.typing import NDArray

from im_cell.robot import Cell
from im_mcs.model import CellModel


def acceleration_share(cell: Cell, positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the share of full acceleration that each joint's torque affords in half of all positions, shape (n,).

    All joints accelerate at once, the others to the side that is worse. A share of 0 or less: the joint does not even
    hold the arm.

    Args:
        cell: The cell, of known masses and torques.
        positions: Of all joints, shape (k, n) [rad or m].
    """
    model = CellModel(cell)
    torque, acceleration = cell.per_joint("limits.torque"), cell.per_joint("limits.acceleration")
    left = np.array([torque - np.abs(model.gravity(q)) for q in positions])
    taken = np.array([np.abs(model.inertia(q)) @ acceleration for q in positions])
    return np.asarray(np.median(left / taken, axis=0))
