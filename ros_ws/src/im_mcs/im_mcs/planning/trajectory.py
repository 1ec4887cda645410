"""Contract of every trajectory."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from im_mcs.planning.setpoint import Setpoint


class Trajectory(Protocol):
    """A motion in its own time, from where it begins to where it ends at rest."""

    duration: float
    """Time from start to rest [s]."""
    edges: NDArray[np.float64]
    """Times at which its pieces begin, shape (m,) [s]."""

    def at(self, t: float) -> Setpoint:
        """Setpoint ``t`` seconds after the start; beyond the duration it stays at the end."""
        ...

    def span(self, t: NDArray[np.float64]) -> Setpoint:
        """Setpoints at many times, ``t`` of shape (m,), at once: q, v and a of shape (m, n)."""
        ...

    def point(self, t: float) -> int:
        """Index of the point of the path that the motion is on its way to at time ``t``."""
        ...
