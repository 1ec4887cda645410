"""Sensor of a camera: pixel noise from the data sheet, and adjustable settings."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from im_core.config import Model

Float = TypeVar("Float", np.float32, np.float64)

QUANTISATION_VARIANCE = 1.0 / 12.0
"""Variance of rounding to whole numbers [DN^2]."""


class SensorNoise(Model):
    """Photon noise, read noise and quantisation of a linear 8-bit sensor.

    Source: EMVA standard 1288, release 4.0, section 2 (linear camera model).

    Attributes:
        gain: Electrons for one step of the digital number [e-/DN].
        read_noise: Standard deviation of a dark pixel [e-].
        black_level: Mean of a dark pixel [DN].
        saturation: Largest value of a pixel [DN].
    """

    gain: float = Field(gt=0.0)
    read_noise: float = Field(ge=0.0)
    black_level: float = Field(ge=0.0, le=64.0)
    saturation: int = Field(default=255, ge=1, le=255)

    def analog_variance(self, mean: NDArray[Float]) -> NDArray[Float]:
        """Variance of pixels before quantisation [DN^2], for expected values `mean` [DN] of any shape."""
        photons: NDArray[Float] = np.maximum(mean - self.black_level, 0.0) / self.gain
        return photons + (self.read_noise / self.gain) ** 2

    def variance(self, mean: NDArray[Float]) -> NDArray[Float]:
        """Variance of pixels after quantisation [DN^2], for expected values `mean` [DN] of any shape."""
        return self.analog_variance(mean) + QUANTISATION_VARIANCE


@dataclass(frozen=True)
class SensorControls:
    """Adjustable settings of a camera, relative to the data sheet: amplification and read noise [-]."""

    gain: float = 1.0
    noise: float = 1.0

    def of(self, sheet: SensorNoise) -> SensorNoise:
        """Return the sensor of a data sheet with the present controls."""
        return sheet.model_copy(update={"gain": sheet.gain / self.gain, "read_noise": sheet.read_noise * self.noise})
