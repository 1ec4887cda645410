"""Grippers: told where to go, done when the jaws stand still."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_STILL_M = 1e-5
_STILL_TICKS = 5


@dataclass
class GripperMotion:
    """Jaws on their way, until they stand still: at the wanted opening, or against something.

    Attributes:
        id: Request that asked for it.
        slot: Which gripper.
        last: Opening of the last tick [m].
        still: For how many ticks the jaws have stood.
    """

    id: int
    slot: int
    last: float
    still: int = 0

    def update(self, openings: NDArray[np.float64]) -> bool:
        """Take the measured openings, shape (m,) [m]; whether the jaws have come to stand."""
        opening = float(openings[self.slot])
        self.still = self.still + 1 if abs(opening - self.last) < _STILL_M else 0
        self.last = opening
        return self.still >= _STILL_TICKS
