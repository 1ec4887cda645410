"""What one pose tells: where the light was, how surely, and whether the images fit to it."""

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError

Array = NDArray[np.float64]


def light_covariance(jacobian: Array, q_covariance: Array, rotation: Array, offset: Array) -> Array:
    """Covariance of the light's position that follows from that of the joints.

    Args:
        jacobian: Of the wrist, linear above angular part, world axes, shape (6, n).
        q_covariance: Of the joint positions, shape (n, n) [rad^2, m^2].
        rotation: World <- wrist, shape (3, 3).
        offset: Nominal position of the light in the wrist frame, shape (3,) [m].

    Returns:
        Covariance in the world frame, shape (3, 3) [m^2].

    Raises:
        DataError: The sizes do not fit, or a value is not finite.
    """
    n = q_covariance.shape[0]
    if jacobian.shape != (6, n) or q_covariance.shape != (n, n):
        raise DataError(
            f"a jacobian of shape {jacobian.shape} does not fit to a covariance of shape {q_covariance.shape}"
        )
    if not (np.isfinite(jacobian).all() and np.isfinite(q_covariance).all()):
        raise DataError("the measured joint positions or their covariance are not finite")
    x, y, z = rotation @ offset
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    point = jacobian[:3] - skew @ jacobian[3:]
    covariance: Array = point @ q_covariance @ point.T
    return 0.5 * (covariance + covariance.T)


def rotation_of(x: float, y: float, z: float, w: float) -> Array:
    """Rotation matrix of a unit quaternion, shape (3, 3)."""
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def check_same_rest(exposed_ns: int, rest_since_ns: int, pose: str) -> None:
    """An image tells of a position only if it was taken in the same rest.

    Args:
        exposed_ns: Testbed time of the exposure [ns].
        rest_since_ns: Testbed time since which the arm has not moved [ns].
        pose: Name of the pose, for the error.

    Raises:
        DataError: The exposure is older than the rest.
    """
    if exposed_ns < rest_since_ns:
        raise DataError(
            f"pose {pose}: the image was exposed {(rest_since_ns - exposed_ns) * 1e-9:.4f} s before the arm came to"
            " rest; it shows another position",
            pose=pose,
        )
