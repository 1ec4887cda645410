"""Pose of a plate from its four corners."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from im_vss.fiducial.corners import Corners

Array = NDArray[np.float64]

_ITERATIONS = 20
_TOLERANCE = 1e-10
_NEAREST_M = 0.01


@dataclass(frozen=True)
class PlatePose:
    """A plate in the optical frame.

    Attributes:
        rotation: Rotation plate -> optical frame, shape (3, 3).
        translation: Centre of the plate in the optical frame, shape (3,) [m].
        covariance: Of (translation [m], small rotation about the axes of the optical frame [rad]), shape (6, 6).
        rms_px: Of the corners [px].
        chi2: Of the corners, 2 degrees of freedom [-].
    """

    rotation: Array
    translation: Array
    covariance: Array
    rms_px: float
    chi2: float


def plate_poses(corners: Corners, K: Array, size: float) -> list[PlatePose]:
    """The poses that a square may have, best first: a small or distant one may as well be tilted the other way.

    Starts: T. Collins, A. Bartoli, "Infinitesimal plane-based pose estimation", IJCV 2014, as in OpenCV; then
    Gauss-Newton with the full covariance of the corners, whose inverse normal matrix is the covariance of the pose.

    Args:
        corners: Undistorted, upper left first, clockwise as printed.
        K: Camera matrix, shape (3, 3) [px].
        size: Side of the square [m].
    """
    half = size / 2.0
    plate = np.array([[-half, half, 0.0], [half, half, 0.0], [half, -half, 0.0], [-half, -half, 0.0]])
    count, rotations, translations, _ = cv2.solvePnPGeneric(
        plate, corners.uv[:, None], K, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    starts = [
        (np.asarray(cv2.Rodrigues(rotations[i])[0], dtype=float), np.asarray(translations[i], dtype=float).ravel())
        for i in range(count)
    ]
    solved = [_refined(*start, plate, corners, K) for start in starts]
    return sorted((pose for pose in solved if pose is not None), key=lambda pose: pose.chi2)


def _refined(rotation: Array, translation: Array, plate: Array, corners: Corners, K: Array) -> PlatePose | None:
    weight = np.linalg.inv(corners.covariance)
    for _ in range(_ITERATIONS):
        if (rotation @ plate.T)[2].min() + translation[2] < _NEAREST_M:
            return None
        residual, jacobian = _linearised(rotation, translation, plate, corners.uv, K)
        step = np.linalg.solve(jacobian.T @ weight @ jacobian, jacobian.T @ weight @ residual)
        translation = translation + step[:3]
        rotation = np.asarray(Rotation.from_rotvec(step[3:]).as_matrix()) @ rotation
        if np.abs(step).max() < _TOLERANCE:
            break
    residual, jacobian = _linearised(rotation, translation, plate, corners.uv, K)
    return PlatePose(
        rotation=rotation,
        translation=translation,
        covariance=np.asarray(np.linalg.inv(jacobian.T @ weight @ jacobian), dtype=float),
        rms_px=float(np.sqrt((residual**2).mean())),
        chi2=float(residual @ weight @ residual),
    )


def _linearised(rotation: Array, translation: Array, plate: Array, uv: Array, K: Array) -> tuple[Array, Array]:
    """Residuals, shape (8,) [px], and Jacobian by translation and left rotation, shape (8, 6)."""
    arms = plate @ rotation.T
    points = arms + translation
    x, y, z = points.T
    by_point = np.zeros((4, 2, 3))
    by_point[:, 0, 0], by_point[:, 0, 2] = K[0, 0] / z, -K[0, 0] * x / z**2
    by_point[:, 1, 1], by_point[:, 1, 2] = K[1, 1] / z, -K[1, 1] * y / z**2
    turn = np.zeros((4, 3, 3))
    for axis in range(3):
        turn[:, :, axis] = np.cross(np.eye(3)[axis], arms)
    jacobian = np.concatenate((by_point, by_point @ turn), axis=-1).reshape(8, 6)
    seen = np.stack((K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]), axis=-1)
    return (uv - seen).ravel(), jacobian
