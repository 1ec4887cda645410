"""How often a limit was in force, for each joint."""

import numpy as np
from numpy.typing import NDArray

KINDS = ("position", "velocity", "acceleration", "jerk", "torque")


class Saturations:
    """Ticks with a setpoint or torque cut by a limit.

    Attributes:
        counts: Shape (kinds, n), in the order of :data:`KINDS`.
    """

    def __init__(self, n_joints: int) -> None:
        self.counts = np.zeros((len(KINDS), n_joints), dtype=np.int64)

    def add(self, kind: str, cut: NDArray[np.bool_]) -> None:
        """Count a tick for the cut joints, shape (n,)."""
        self.counts[KINDS.index(kind)] += cut
