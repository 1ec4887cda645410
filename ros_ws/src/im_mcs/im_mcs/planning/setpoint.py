"""What the planning layer hands to the control layer, once a servo tick."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Setpoint:
    """Wanted motion of some joints at one instant.

    Attributes:
        q: Positions, shape (n,) [rad or m].
        v: Velocities, shape (n,) [rad/s or m/s].
        a: Accelerations, shape (n,) [rad/s2 or m/s2].
    """

    q: NDArray[np.float64]
    v: NDArray[np.float64]
    a: NDArray[np.float64]

    @classmethod
    def at_rest(cls, q: NDArray[np.float64]) -> Self:
        """Standing still at ``q``, shape (n,)."""
        return cls(q.copy(), np.zeros_like(q), np.zeros_like(q))

    def put(self, index: NDArray[np.intp], part: "Setpoint") -> None:
        """Enter the motion of the joints ``index`` into that of all joints."""
        self.q[index], self.v[index], self.a[index] = part.q, part.v, part.a
