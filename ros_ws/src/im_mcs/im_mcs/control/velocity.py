"""Velocity from encoder readings."""

import math

import numpy as np
from numpy.typing import NDArray


class VelocityEstimator:
    """Backward difference through a first-order low pass.

    Args:
        n: Number of signals.
        period_s: Servo period [s].
        bandwidth_rad_s: Corner of the low pass [rad/s].
    """

    def __init__(self, n: int, period_s: float, bandwidth_rad_s: float) -> None:
        # numpy is quicker with two arrays than with a number and an array
        self._gain = np.full(n, (1.0 - math.exp(-bandwidth_rad_s * period_s)) / period_s)
        self._decay = np.full(n, math.exp(-bandwidth_rad_s * period_s))
        self._last: NDArray[np.float64] | None = None
        self._value = np.zeros(n)

    def reset(self) -> None:
        """Forget the past: the next reading is taken as standing still."""
        self._last = None
        self._value = np.zeros_like(self._value)

    def update(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take a reading, shape (n,), and return its derivative, shape (n,)."""
        if self._last is not None:
            self._value = self._decay * self._value + self._gain * (x - self._last)
        self._last = x
        return self._value
