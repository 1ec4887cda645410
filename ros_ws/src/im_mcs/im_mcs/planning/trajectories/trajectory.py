"""Setpoints from the planning layer to the control layer, once a servo tick, and the contract of every trajectory."""

from typing import NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray


class Setpoint(NamedTuple):
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


class Trajectory(Protocol):
    """Motion as a function of time, from the begin to the end at rest."""

    duration: float
    """Time from start to rest [s]."""
    edges: NDArray[np.float64]
    """Times at which its pieces begin, shape (m,) [s]."""

    def at(self, t: float) -> Setpoint:
        """Return the setpoint ``t`` seconds after the start; beyond the duration, the end."""
        ...

    def span(self, t: NDArray[np.float64]) -> Setpoint:
        """Return setpoints at many times, ``t`` of shape (m,), at once: q, v and a of shape (m, n)."""
        ...

    def jerk(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return third derivatives at many times, shape (m,): shape (m, n); at a border, of the later piece."""
        ...

    def point(self, t: float) -> int:
        """Return the index of the next point of the path at time ``t``."""
        ...
