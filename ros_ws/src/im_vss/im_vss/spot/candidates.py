"""Places where a difference of two frames may hold a spot."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from im_vss.spot.noise import SensorNoise

Frame = NDArray[np.uint8]

_REACH_SIGMAS = 4.0


@dataclass(frozen=True)
class Peak:
    """A local maximum of the matched filter.

    Attributes:
        u: Column [px].
        v: Row [px].
        snr: Response over the standard deviation that noise alone gives [-].
    """

    u: int
    v: int
    snr: float


class MatchedFilter:
    """Signal-to-noise ratio of a Gaussian spot at every pixel of a difference of two frames.

    Source: North's matched filter for white noise, after dividing each pixel by its standard deviation.
    """

    def __init__(self, on: Frame, off: Frame, sigma: float, noise: SensorNoise) -> None:
        """Filter ``on - off``, shape (h, w) [DN], for spots of standard deviation `sigma` [px]."""
        reach = int(np.ceil(_REACH_SIGMAS * sigma))
        gaussian = np.asarray(cv2.getGaussianKernel(2 * reach + 1, sigma, cv2.CV_32F), dtype=np.float32)
        kernel = gaussian / np.sqrt((gaussian**2).sum())
        background = cv2.blur(off, (3, 3)).astype(np.float32)
        deviation = np.sqrt(2.0 * noise.variance(background))
        whitened = cv2.subtract(on, off, dtype=cv2.CV_32F) / deviation
        self._response = np.asarray(
            cv2.sepFilter2D(whitened, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_CONSTANT), dtype=np.float32
        )

    def strongest(self) -> Peak:
        """The strongest peak that was not erased."""
        _, snr, _, (u, v) = cv2.minMaxLoc(self._response)
        return Peak(u=u, v=v, snr=snr)

    def confine(self, u: float, v: float, radius: float) -> None:
        """Leave only a disc of `radius` [px] around (u, v) [px] to the search."""
        outside = np.full(self._response.shape, 255, np.uint8)
        cv2.circle(outside, (round(u), round(v)), int(np.ceil(radius)), 0, thickness=-1)
        self._response[outside > 0] = -np.inf

    def erase(self, u: float, v: float, radius: float) -> None:
        """Take a disc of `radius` [px] around (u, v) [px] out of the search."""
        cv2.circle(self._response, (round(u), round(v)), int(np.ceil(radius)), -np.inf, thickness=-1)
