"""Evidence from one arm pose: certainty of the place of light and wrist, and test whether images show the pose."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_cell.rotations import cross_matrix
from im_core.errors import DataError

Array = NDArray[np.float64]

#: Code of errors that concern the observation of one pose, which a calibration may do without.
UNUSABLE = "unusable"


@dataclass(frozen=True)
class MeasuredRest:
    """Measured pose of an arm at rest.

    Attributes:
        jacobian: Of the wrist, linear above angular part, world axes, shape (6, n).
        q_covariance: Of the joint positions, shape (n, n) [rad^2, m^2].
        rotation: World <- wrist, shape (3, 3).
        since_ns: Testbed time since which it has not moved [ns].
    """

    jacobian: Array
    q_covariance: Array
    rotation: Array
    since_ns: int

    def point_covariance(self, offset: Array) -> Array:
        """Return the covariance of the position of a point on the wrist, from the covariance of the joints.

        Args:
            offset: Position of the point in the wrist frame, shape (3,) [m].

        Returns:
            Covariance in the world frame, shape (3, 3) [m^2].

        Raises:
            DataError: The sizes do not fit, or a value is not finite.
        """
        point = np.hstack((np.eye(3), -cross_matrix(self.rotation @ offset)))
        covariance: Array = point @ self.wrist_covariance() @ point.T
        return 0.5 * (covariance + covariance.T)

    def wrist_covariance(self) -> Array:
        """Return the covariance of the wrist, from the covariance of the joints.

        Returns:
            Of the place and the turn, world axes, shape (6, 6) [m^2], [m rad], [rad^2].

        Raises:
            DataError: The sizes do not fit, or a value is not finite.
        """
        shape, n = self.jacobian.shape, self.q_covariance.shape[0]
        if shape != (6, n) or self.q_covariance.shape != (n, n):
            text = f"a jacobian of shape {shape} does not fit to a covariance of shape {self.q_covariance.shape}"
            raise DataError(text, code=UNUSABLE)
        if not (np.isfinite(self.jacobian).all() and np.isfinite(self.q_covariance).all()):
            raise DataError("the measured joint positions or their covariance are not finite", code=UNUSABLE)
        covariance: Array = self.jacobian @ self.q_covariance @ self.jacobian.T
        return 0.5 * (covariance + covariance.T)

    def require_shown(self, exposed_ns: int, pose: str) -> None:
        """Refuse an image exposed before the rest: an image gives a position only if taken during the same rest.

        Args:
            exposed_ns: Testbed time of the exposure [ns].
            pose: Name of the pose, for the error.

        Raises:
            DataError: The exposure is older than the rest.
        """
        if exposed_ns < self.since_ns:
            text = (
                f"pose {pose}: the image was exposed {(self.since_ns - exposed_ns) * 1e-9:.4f} s before the arm came"
                " to rest; it shows another position"
            )
            raise DataError(text, code=UNUSABLE, pose=pose)
