"""Agreement of each camera with the robot and with the other cameras: search for the source of a misfit."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.chi_squared import chi2_beyond
from im_calibration.estimation.residuals import Linearisation
from im_calibration.estimation.unknowns import ParameterLayout

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class CameraAgreement:
    """Share of one camera in the joint chi-square.

    Attributes:
        chi2: Squared Mahalanobis length of its residuals, given those of the other cameras.
        dof: Its degrees of freedom.
    """

    chi2: float
    dof: int

    @property
    def chi2_per_dof(self) -> float:
        """Reduced chi-square."""
        return self.chi2 / self.dof

    @property
    def log_chance(self) -> float:
        """Logarithm of the probability of a `chi2` equally large or larger."""
        with np.errstate(divide="ignore"):
            return float(np.log(chi2_beyond(self.chi2, self.dof)))


def camera_agreements(line: Linearisation, used: Mask, layout: ParameterLayout) -> tuple[CameraAgreement, ...]:
    """Measure the agreement of each camera with the robot and the other cameras.

    Cameras share the uncertain positions of the LED, so that each may agree with the robot by itself while they
    contradict each other: what counts is by how much the joint chi-square drops without the camera.

    Args:
        line: The problem at the estimate.
        used: Which spots count, shape (c, n).
        layout: Places of the unknowns.
    """
    everyone = _chi2(line.residuals, line.covariances)
    found = []
    for c, spots in enumerate(used):
        others = np.delete(np.arange(line.residuals.shape[1]), (2 * c, 2 * c + 1))
        rest = _chi2(line.residuals[:, others], line.covariances[:, others[:, None], others])
        block = layout.camera_slice(c)
        unknowns = block.stop - block.start
        found.append(CameraAgreement(everyone - rest, max(1, 2 * int(spots.sum()) - unknowns)))
    return tuple(found)


def _chi2(residuals: Array, covariances: Array) -> float:
    return float((residuals * np.linalg.solve(covariances, residuals[..., None])[..., 0]).sum())
