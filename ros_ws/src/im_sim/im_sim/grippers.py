"""Pneumatic grippers: the jaws travel at a fixed rate towards the wanted opening."""

import numpy as np
from numpy.typing import NDArray

from im_core.robot import Gripper


class Grippers:
    """Both grippers.

    Attributes:
        opening: Of the jaws, shape (2,) [m].
    """

    def __init__(self, gripper: Gripper) -> None:
        self._gripper = gripper
        self.opening = np.full(2, gripper.initial)
        self._wanted = self.opening.copy()

    def command(self, opening: NDArray[np.float64]) -> None:
        """Set the wanted openings, shape (2,) [m]; values outside the stroke are cut to it, NaN changes nothing."""
        wanted = np.where(np.isfinite(opening), opening, self._wanted)
        self._wanted = np.clip(wanted, 0.0, self._gripper.stroke)

    def step(self, dt: float) -> None:
        """Let ``dt`` [s] pass; the valves keep their position without motor power."""
        reach = self._gripper.rate * dt
        self.opening = self.opening + np.clip(self._wanted - self.opening, -reach, reach)
