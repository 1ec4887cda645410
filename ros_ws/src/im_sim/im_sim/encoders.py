"""Encoders: noise, then quantisation."""

import numpy as np
from numpy.typing import NDArray

from im_core.robot import Cell
from im_core.testbed_link import Faults
from im_sim.noise import TickNoise


class Encoders:
    """Reads joint positions as the machine sees them.

    Args:
        cell: Resolution and noise of each joint.
        seed: Key of the noise: the same seed and tick give the same noise, whatever was read before.
    """

    def __init__(self, cell: Cell, seed: int) -> None:
        self._resolution = cell.per_joint("resolution")
        self._noise = TickNoise(seed, 0, cell.per_joint("noise"))
        n = len(self._resolution)
        self._fresh = np.zeros(n)
        self._frozen = np.zeros(n, dtype=np.bool_)
        self._frozen_since = np.zeros(n, dtype=np.int64)
        self._frozen_reading = np.zeros(n)
        self._blind = np.zeros(n, dtype=np.bool_)
        self._sound = True
        self._period_s = cell.period

    def break_(self, faults: Faults, tick: int, q: NDArray[np.float64]) -> None:
        """Put faults in force at a tick, at true positions ``q``, shape (n,): a frozen reading is the one of then."""
        newly = faults.encoder_frozen & ~self._frozen
        self._frozen_since[newly] = tick
        self._frozen_reading[newly] = self._reading(tick, q)[newly]
        self._frozen, self._blind = faults.encoder_frozen, faults.encoder_nan
        self._sound = not (self._frozen.any() or self._blind.any())

    def read(self, tick: int, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Readings of the true positions ``q`` at a tick, shape (n,) [rad or m], and their ages, shape (n,) [s]."""
        reading = self._reading(tick, q)
        if self._sound:
            return reading, self._fresh
        reading = np.where(self._frozen, self._frozen_reading, reading)
        reading[self._blind] = np.nan
        return reading, np.where(self._frozen, (tick - self._frozen_since) * self._period_s, 0.0)

    def _reading(self, tick: int, q: NDArray[np.float64]) -> NDArray[np.float64]:
        reading: NDArray[np.float64] = np.rint((q + self._noise.at(tick)) / self._resolution) * self._resolution
        return reading
