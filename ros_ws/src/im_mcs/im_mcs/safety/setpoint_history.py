"""Setpoints of the last ticks: late readings are compared with earlier setpoints."""

import math

import numpy as np
from numpy.typing import NDArray

from im_mcs.limits.vectors import any_beyond


class SetpointHistory:
    """Ring of the setpoints of all joints.

    Args:
        q: Where the joints stand at first, shape (n,) [rad or m].
        period_s: Servo period [s].
        longest_s: Age of the oldest reading that is asked for [s]; an older one is compared with the last of the ring.
    """

    def __init__(self, q: NDArray[np.float64], period_s: float, longest_s: float) -> None:
        self._rows = np.zeros((math.ceil(longest_s / period_s) + 1, 2, len(q)))
        self._rows[:, 0] = q
        self._newest, self._period_s = 0, period_s
        self._fresh = np.full(len(q), period_s / 2.0)
        self._joints = np.arange(len(q))

    def push_setpoint(self, setpoint: NDArray[np.float64]) -> None:
        """Keep the setpoint of a tick: positions, velocities, accelerations, shape (3, n)."""
        self._newest = (self._newest + 1) % len(self._rows)
        self._rows[self._newest] = setpoint[:2]

    def at(self, age_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions and velocities followed at the times of readings, shape (2, n).

        Args:
            age_s: Age of each joint's reading, shape (n,) [s]; one that is not a number counts as 0.
        """
        found: NDArray[np.float64] = self._rows[self._newest]
        if any_beyond(age_s, self._fresh):
            ticks = np.clip(np.nan_to_num(np.rint(age_s / self._period_s)), 0, len(self._rows) - 1).astype(np.intp)
            found = self._rows[(self._newest - ticks) % len(self._rows), :, self._joints].T
        return found
