"""Two cameras: triangulation with covariance, epipolar distances, rectification."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from im_cell.calibration_files.intrinsics import Rectified
from im_cell.camera_model import CameraModel
from im_cell.frames import Image
from im_cell.lens import EQUIDISTANT
from im_cell.rotations import cross_matrix
from im_core.errors import DataError

Array = NDArray[np.float64]

_ITERATIONS = 20
_TOLERANCE_M = 1e-10
_PARALLEL = 1e-9
_SHORTEST_BASELINE_M = 1e-6


@dataclass(frozen=True)
class Point:
    """A point in the world.

    Attributes:
        position: Where it is, shape (3,) [m].
        covariance: By spots and calibration together, shape (3, 3) [m^2].
        by_spots: The spots' part of it, shape (3, 3) [m^2].
        by_cameras: How it moves with the parameters of the c cameras, shape (3, 18 c) [m by the unit of each].
    """

    position: Array
    covariance: Array
    by_spots: Array
    by_cameras: Array


def triangulate(
    cameras: Sequence[CameraModel], spots: Sequence[Array], covariances: Sequence[Array], calibration: Array
) -> Point:
    """Return the best point for the images: Gauss-Newton from the point nearest to all rays.

    Args:
        cameras: Two cameras or more, with their poses.
        spots: Where each saw the point, shape (2,) [px].
        covariances: Of the spots, shape (2, 2) [px^2].
        calibration: Covariance of the parameters of all cameras, see :data:`im_cell.camera_model.PARAMETERS`, shape
            (18 c, 18 c).

    Returns:
        The point.

    Raises:
        DataError: The rays are parallel, or the lens model cannot be inverted at a spot.
    """
    across = [np.eye(3) - np.outer(ray, ray) for ray in (c.ray(uv) for c, uv in zip(cameras, spots, strict=True))]
    normal = np.asarray(sum(across))
    if np.linalg.eigvalsh(normal)[0] < _PARALLEL:
        raise DataError("the rays of the two spots are parallel")
    position = np.linalg.solve(normal, sum(a @ c.position for a, c in zip(across, cameras, strict=True)))
    weights = [np.linalg.inv(covariance) for covariance in covariances]
    for _ in range(_ITERATIONS):
        jacobians = [camera.project_jacobian(position) for camera in cameras]
        information = sum(J.T @ W @ J for J, W in zip(jacobians, weights, strict=True))
        slope = sum(
            J.T @ W @ (uv - camera.project(position))
            for J, W, uv, camera in zip(jacobians, weights, spots, cameras, strict=True)
        )
        step = np.linalg.solve(information, slope)
        position = position + step
        if not np.all(np.isfinite(position)):
            raise DataError("the two spots are not of a point in front of both cameras")
        if np.abs(step).max() < _TOLERANCE_M:
            break
    by_spots = np.linalg.inv(np.asarray(information))
    by_cameras = np.hstack(
        [
            -by_spots @ J.T @ W @ camera.project_by_parameters(position)
            for J, W, camera in zip(jacobians, weights, cameras, strict=True)
        ]
    )
    return Point(position, by_spots + by_cameras @ calibration @ by_cameras.T, by_spots, by_cameras)


def essential_matrix(first: CameraModel, second: CameraModel) -> Array:
    """Return E with ``y' E x = 0`` for ideal images x, y of one point in two cameras with poses, shape (3, 3)."""
    rotation = second.R_cam_base @ first.R_cam_base.T
    t = second.t_cam_base - rotation @ first.t_cam_base
    return np.asarray(cross_matrix(t) @ rotation)


def epipolar_distance(first: CameraModel, second: CameraModel, spots: Sequence[Array]) -> float:
    """How far each of two spots is from the epipolar line of the other, the larger of the two [px].

    Args:
        first: A camera with its pose.
        second: Another.
        spots: What each saw, shape (2,) [px]; measured where the lens distortion is taken out.

    Raises:
        DataError: The lens model cannot be inverted at a spot.
    """
    essential = essential_matrix(first, second)
    x, y = (np.append(camera.undistort(uv), 1.0) for camera, uv in zip((first, second), spots, strict=True))
    error = abs(float(y @ essential @ x))
    lines = (essential.T @ y, first), (essential @ x, second)
    return max(float(error * np.sqrt(camera.K[0, 0] * camera.K[1, 1]) / np.hypot(*line[:2])) for line, camera in lines)


@dataclass(frozen=True)
class Rectification:
    """R, shape (3, 3), and P, shape (3, 4) [px], of the left and of the right camera, as in a `CameraInfo`."""

    left: tuple[Array, Array]
    right: tuple[Array, Array]


def rectify(left: CameraModel, right: CameraModel) -> Rectification:
    """Return rotations to aligned image rows of two cameras, and projections; ``P[0, 3]`` holds the baseline.

    Source: A. Fusiello, E. Trucco, A. Verri, "A compact algorithm for rectification of stereo pairs", 2000, as in
    OpenCV.

    Raises:
        DataError: The second camera is not beside the first, or where the first is: their images cannot have rows in
            common.
    """
    rotation = right.R_cam_base @ left.R_cam_base.T
    t = right.t_cam_base - rotation @ left.t_cam_base
    size = (left.width, left.height)
    if not np.linalg.norm(t) > _SHORTEST_BASELINE_M:
        raise DataError("the cameras of a stereo pair are at the same place")
    # Which way images are turned does not depend on the lenses. OpenCV takes none but its own here, and inverts them in
    # the corners for the focal length and centre that both images get: one lens would spoil both.
    first, second = (_of_corners(camera) for camera in (left, right))
    R1, R2, P1, P2, *_ = cv2.stereoRectify(
        left.K, first, right.K, second, size, rotation, t, flags=cv2.CALIB_ZERO_DISPARITY, alpha=-1.0
    )
    finite = np.all(np.isfinite(np.hstack((R1, R2, P1, P2))))
    if not finite or not P2[0, 3] < 0.0 or abs(P2[1, 3]) > 1e-9:
        raise DataError("the cameras of a stereo pair must stand side by side, the left one first")
    return Rectification((np.asarray(R1), np.asarray(P1)), (np.asarray(R2), np.asarray(P2)))


def _of_corners(camera: CameraModel) -> Array:
    return np.zeros(5) if camera.lens is EQUIDISTANT or camera.invertible_share < 1.0 else camera.D


class ImageRectification:
    """Map from a camera's image to the rectified one (Hartley and Zisserman, section 11.12).

    A pixel of the rectified image is a ray of the camera with the matrix P, turned back by R; the lens of the real
    camera says where that ray meets its image.

    Args:
        model: Intrinsics and lens of the camera.
        rectified: R and P of its camera info.
    """

    def __init__(self, model: CameraModel, rectified: Rectified) -> None:
        rows, columns = np.indices((model.height, model.width), dtype=float)
        pixels = np.stack((columns, rows, np.ones_like(rows)), axis=-1)
        rays = pixels @ np.linalg.inv(rectified.P[:, :3]).T @ rectified.R  # rows, to which R^T is applied
        places = model.through_lens(rays[..., :2] / rays[..., 2:]).astype(np.float32)
        self._columns, self._rows = places[..., 0], places[..., 1]

    def apply(self, image: Image) -> Image:
        """Return the rectified image, shape (height, width) as the given one; black where the camera does not see."""
        return np.asarray(cv2.remap(image, self._columns, self._rows, cv2.INTER_LINEAR), dtype=np.uint8)
