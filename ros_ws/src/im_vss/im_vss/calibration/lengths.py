"""Known lengths: two LEDs at a measured distance, seen by several cameras. The only judge of the robot's own scale."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class KnownLengths:
    """k placements of pairs of LEDs, anywhere in view and however turned; a placement is wherever the cameras see it.

    Attributes:
        lengths: Distances of the two LEDs, shape (k,) [m].
        standard_deviations: How well they are known, shape (k,) [m].
        spots: Spots of both LEDs by camera, placement and LED, NaN where not seen, shape (c, k, 2, 2) [px].
        spot_covariances: Their covariances, ignored where there is no spot, shape (c, k, 2, 2, 2) [px^2].
    """

    lengths: Array
    standard_deviations: Array
    spots: Array
    spot_covariances: Array

    def __post_init__(self) -> None:
        """Check shapes and values.

        Raises:
            DataError: An array has the wrong shape or a value that cannot be; the message names it.
        """
        k, c = len(self.lengths), len(self.spots)
        shapes = {"standard_deviations": (k,), "spots": (c, k, 2, 2), "spot_covariances": (c, k, 2, 2, 2)}
        for name, shape in shapes.items():
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != shape:
                raise DataError(f"{name} of the known lengths has shape {value.shape}, it must be {shape}.", array=name)
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if not np.all(np.isfinite(self.lengths) & (np.asarray(self.lengths) > 0.0)):
            raise DataError("Each known length must be a finite number > 0 [m].", array="lengths")
        if not np.all(np.isfinite(self.standard_deviations) & (self.standard_deviations >= 0.0)):
            raise DataError("Each standard deviation of a known length must be a finite number >= 0 [m].")
        if np.any(np.isinf(self.spots)) or np.any(np.isnan(self.spots).sum(axis=3) == 1):
            raise DataError("A spot of a known length must be two finite numbers, or two NaN where it was not seen.")
        if np.any(np.linalg.eigvalsh(self.spot_covariances[self.detected])[:, :1] <= 0.0):
            raise DataError("A spot covariance of a known length is not a covariance matrix.")

    @property
    def detected(self) -> Mask:
        """Where a camera saw an LED, shape (c, k, 2)."""
        return np.asarray(~np.isnan(self.spots[..., 0]))
