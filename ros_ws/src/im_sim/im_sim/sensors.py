"""Noise that depends on seed and tick alone, whatever was read before."""

import numpy as np
from numpy.typing import NDArray

from im_core.robot import SensorSpec

_TICKS_PER_BLOCK = 256
_STREAM_SHIFT = 48


class TickNoise:
    """Normal noise of several signals.

    Args:
        seed: Key of the noise.
        stream: Which sensor; streams of one seed are independent, 0 to 65535.
        deviation: Standard deviation of each signal, shape (n,).
        mean: Of each signal, shape (n,); zero if not given.
    """

    def __init__(
        self, seed: int, stream: int, deviation: NDArray[np.float64], mean: NDArray[np.float64] | float = 0.0
    ) -> None:
        self._seed = seed & 0xFFFFFFFFFFFFFFFF
        self._stream = stream << _STREAM_SHIFT
        self._deviation, self._mean = deviation, mean
        self._block = -1
        self._draws: NDArray[np.float64] = np.empty((0, 0))

    def at(self, tick: int) -> NDArray[np.float64]:
        """Noise at a tick, shape (n,)."""
        block, row = divmod(tick, _TICKS_PER_BLOCK)
        if block != self._block:
            key = np.array([self._seed, self._stream | block], dtype=np.uint64)
            generator = np.random.Generator(np.random.Philox(key=key))
            draws = generator.standard_normal((_TICKS_PER_BLOCK, len(self._deviation)))
            self._draws = draws * self._deviation + self._mean
            self._block = block
        draw: NDArray[np.float64] = self._draws[row]
        return draw


class ForceSensors:
    """Sensors of forces or torques: a fixed bias, noise, quantisation, and the end of their range.

    Args:
        specs: Of each signal.
        seed: Of bias and noise.
        stream: As of :class:`TickNoise`; the one after is used for the bias.
    """

    def __init__(self, specs: list[SensorSpec], seed: int, stream: int) -> None:
        bias = TickNoise(seed, stream + 1, np.array([spec.bias for spec in specs])).at(0)
        self._noise = TickNoise(seed, stream, np.array([spec.noise for spec in specs]), bias)
        self._resolution = np.array([spec.resolution for spec in specs])
        self._most = np.array([spec.range for spec in specs])
        self._least = -self._most

    def read(self, tick: int, true: NDArray[np.float64]) -> NDArray[np.float64]:
        """Readings of ``true``, shape (n,), at a tick [N or Nm]."""
        steps = np.rint((true + self._noise.at(tick)) / self._resolution) * self._resolution
        reading: NDArray[np.float64] = np.minimum(np.maximum(steps, self._least), self._most)
        return reading
