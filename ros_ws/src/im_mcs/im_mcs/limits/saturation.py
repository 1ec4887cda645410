"""How often a limit was in force, for each joint."""

import numpy as np
from numpy.typing import NDArray

KINDS = ("position", "velocity", "acceleration", "jerk", "torque")


class Saturations:
    """Ticks in which a limit cut what was wanted.

    Attributes:
        counts: Shape (kinds, n), in the order of :data:`KINDS`.

    Args:
        n_joints: Number of joints.
    """

    def __init__(self, n_joints: int) -> None:
        self.counts = np.zeros((len(KINDS), n_joints), dtype=np.int64)

    def add(self, kind: str, cut: NDArray[np.bool_]) -> None:
        """Count a tick for the joints that were cut, shape (n,)."""
        self.counts[KINDS.index(kind)] += cut
