"""Encoders: noise that depends on seed and tick alone, then quantisation."""

import numpy as np
from numpy.typing import NDArray

from im_core.robot import Cell

_TICKS_PER_BLOCK = 256


class Encoders:
    """Reads joint positions as the machine sees them.

    Args:
        cell: Resolution and noise of each joint.
        seed: Key of the noise: the same seed and tick give the same noise, whatever was read before.
    """

    def __init__(self, cell: Cell, seed: int) -> None:
        self._resolution = cell.per_joint("resolution")
        self._noise = cell.per_joint("noise")
        self._seed = seed & 0xFFFFFFFFFFFFFFFF
        self._block = -1
        self._draws: NDArray[np.float64] = np.empty((0, 0))

    def read(self, tick: int, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Reading of the true positions ``q``, shape (n,), at a tick [rad or m]."""
        block, row = divmod(tick, _TICKS_PER_BLOCK)
        if block != self._block:
            generator = np.random.Generator(np.random.Philox(key=np.array([self._seed, block], dtype=np.uint64)))
            self._draws = generator.standard_normal((_TICKS_PER_BLOCK, len(self._noise))) * self._noise
            self._block = block
        reading: NDArray[np.float64] = np.rint((q + self._draws[row]) / self._resolution) * self._resolution
        return reading
