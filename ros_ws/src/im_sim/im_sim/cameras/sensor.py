"""The sensor chip: from expected pixel values to a noisy 8-bit image."""

import zlib

import numpy as np
from numpy.typing import NDArray

from im_cell.sensor import SensorNoise

FloatImage = NDArray[np.float32]


def noise_stream(seed: int, camera: str, start_tick: int, frame: int) -> np.random.Generator:
    """Random stream of one exposure of one camera: the same whenever the same exposure is repeated.

    Args:
        seed: Seed of the testbed.
        camera: Name of the camera.
        start_tick: Tick at which the shutter opened.
        frame: Number of the exposure in its request.
    """
    entropy = [seed & 0xFFFFFFFFFFFFFFFF, zlib.crc32(camera.encode()), start_tick, frame]
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(entropy)))


def read_out(mean: FloatImage, sensor: SensorNoise, stream: np.random.Generator, out: NDArray[np.uint8]) -> None:
    """Write the sensor's image of expected values.

    Photon noise is drawn as Gaussian of the Poisson distribution's variance: a pixel holds some hundred electrons.

    Args:
        mean: Expected values with the black level, shape (h, w) [DN].
        sensor: Gain, noise and saturation.
        stream: Source of the noise.
        out: Where the image goes, shape (h, w) [DN].
    """
    noisy = stream.standard_normal(mean.shape, dtype=np.float32)
    noisy *= np.sqrt(sensor.analog_variance(mean))
    noisy += mean
    np.rint(noisy, out=noisy)
    np.clip(noisy, 0.0, float(sensor.saturation), out=noisy)
    out[:] = noisy
