"""Contract of every trajectory, and the simplest of them."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from im_mcs.planning.setpoint import Setpoint


class Trajectory(Protocol):
    """A motion in time; ends at rest."""

    duration: float
    """Time from start to rest [s]."""

    def at(self, t: float) -> Setpoint:
        """Setpoint ``t`` seconds after the start; beyond the duration it stays at the end."""
        ...

    def point(self, t: float) -> int:
        """Index of the point of the path that the motion is on its way to at time ``t``."""
        ...


class Hold:
    """Standing still.

    Args:
        q: Positions, shape (n,) [rad or m].
    """

    duration = 0.0

    def __init__(self, q: NDArray[np.float64]) -> None:
        self._setpoint = Setpoint.at_rest(q)

    def at(self, t: float) -> Setpoint:
        """The same setpoint for every ``t``."""
        return self._setpoint

    def point(self, t: float) -> int:
        """Always 0: there is one point."""
        return 0
