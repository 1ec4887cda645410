"""Fiducial plates in an image: the corners by the edges, and the poses by the corners."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from im_cell.camera_model import CameraModel
from im_cell.fiducial import CELLS
from im_cell.robot import Target
from im_cell.rotations import cross_matrix, matrix_of_vector
from im_cell.sensor import SensorNoise
from im_core.errors import DataError
from im_vss.edges.step import Image, StraightEdge, follow_edge, undistorted_by_parameters

Array = NDArray[np.float64]

_MARGIN_SHARE = 0.12
_SMALLEST_HALF_PX, _CELLS_HALF = 2.0, 0.5
_ITERATIONS = 20
_TOLERANCE = 1e-10
_NEAREST_M = 0.01
_DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)


@dataclass(frozen=True)
class Corners:
    """Four corners in undistorted pixels, shape (4, 2) [px], and the joint covariance, shape (8, 8) [px^2]."""

    uv: Array
    covariance: Array


def refine_corners(image: Image, camera: CameraModel, rough: Array, cells: int, noise: SensorNoise) -> Corners | None:
    """Fit and intersect the four edges of a black square on white.

    Args:
        image: Pixels, shape (h, w) [DN].
        camera: Intrinsics and lens.
        rough: Corners as detected, clockwise, shape (4, 2) [px].
        cells: Cells along a side: the border's width says how far from an edge pixels may be used.
        noise: Noise of the sensor.

    Returns:
        The corners in the same order, None where an edge cannot be fitted.

    Raises:
        DataError: The lens model cannot be inverted there.
    """
    edges: list[StraightEdge] = []
    for k in range(4):
        ends = rough[[k, (k + 1) % 4]]
        length = float(np.linalg.norm(ends[1] - ends[0]))
        half = max(_SMALLEST_HALF_PX, _CELLS_HALF * length / cells)
        edge = follow_edge(image, camera, ends, half, _MARGIN_SHARE * length, noise)
        if edge is None:
            return None
        edges.append(edge)
    uv, jacobian, covariance = np.zeros((4, 2)), np.zeros((8, 8)), np.zeros((8, 8))
    for k in range(4):
        first, second = (k - 1) % 4, k
        normals = np.stack([edges[first].normal, edges[second].normal])
        uv[k] = np.linalg.solve(normals, [n @ edges[e].middle for n, e in zip(normals, (first, second), strict=True)])
        inverse = np.linalg.inv(normals)
        for column, e in enumerate((first, second)):
            arm = float((uv[k] - edges[e].middle) @ edges[e].direction)
            jacobian[2 * k : 2 * k + 2, 2 * e : 2 * e + 2] = np.outer(inverse[:, column], [1.0, arm])
        covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = edges[k].fit.covariance
    return Corners(uv, jacobian @ covariance @ jacobian.T)


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
    """Return the possible poses of a square, best first: a small or distant one may as well be tilted the other way.

    Starts: T. Collins, A. Bartoli, "Infinitesimal plane-based pose estimation", IJCV 2014, as in OpenCV; then
    Gauss-Newton with the full covariance of the corners, whose inverse normal matrix is the covariance of the pose.

    Args:
        corners: Undistorted, upper left first, clockwise as printed.
        K: Camera matrix, shape (3, 3) [px].
        size: Side of the square [m].
    """
    plate = _square(size)
    count, rotations, translations, _ = cv2.solvePnPGeneric(
        plate, corners.uv[:, None], K, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    starts = [
        (matrix_of_vector(rotations[i].ravel()), np.asarray(translations[i], dtype=float).ravel()) for i in range(count)
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
        rotation = matrix_of_vector(step[3:]) @ rotation
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


def with_calibration(pose: PlatePose, corners: Corners, camera: CameraModel, size: float, lens: Array) -> PlatePose:
    """Return a pose with the uncertainty of the camera in the covariance.

    Args:
        pose: The pose by the corners, its covariance that of the corners alone.
        corners: Undistorted.
        camera: Intrinsics and lens.
        size: Side of the square [m].
        lens: Covariance of its parameters, of which the pose does not count, shape (18, 18).
    """
    _, jacobian = _linearised(pose.rotation, pose.translation, _square(size), corners.uv, camera.K)
    moved = undistorted_by_parameters(camera, corners.uv).reshape(8, -1)
    by_camera = pose.covariance @ jacobian.T @ np.linalg.solve(corners.covariance, moved)
    return replace(pose, covariance=pose.covariance + by_camera @ lens @ by_camera.T)


def _square(size: float) -> Array:
    """Return the corners of a plate's square in the plate's frame, upper left first, clockwise, shape (4, 3) [m]."""
    half = size / 2.0
    return np.array([[-half, half, 0.0], [half, half, 0.0], [half, -half, 0.0], [-half, -half, 0.0]])


def _linearised(rotation: Array, translation: Array, plate: Array, uv: Array, K: Array) -> tuple[Array, Array]:
    """Residuals, shape (8,) [px], and Jacobian by translation and left rotation, shape (8, 6)."""
    arms = plate @ rotation.T
    points = arms + translation
    x, y, z = points.T
    by_point = np.zeros((4, 2, 3))
    by_point[:, 0, 0], by_point[:, 0, 2] = K[0, 0] / z, -K[0, 0] * x / z**2
    by_point[:, 1, 1], by_point[:, 1, 2] = K[1, 1] / z, -K[1, 1] * y / z**2
    jacobian = np.concatenate((by_point, -by_point @ cross_matrix(arms)), axis=-1).reshape(8, 6)
    seen = np.stack((K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]), axis=-1)
    return (uv - seen).ravel(), jacobian


@dataclass(frozen=True)
class FiducialFit:
    """Plate: target of the cell, the pose, the corners in the image, shape (4, 2) [px].

    Attributes:
        target: Which one.
        pose: Where it is in the optical frame.
        corners: Upper left first, clockwise as printed, shape (4, 2) [px].
        ambiguity: Reprojection error of this pose over that of the mirrored one, 0 to 1.
    """

    target: Target
    pose: PlatePose
    corners: Array
    ambiguity: float


def find_fiducials(
    image: Image, camera: CameraModel, noise: SensorNoise, wanted: Mapping[int, Target], calibration: Array
) -> tuple[list[FiducialFit], dict[int, str]]:
    """Find plates in an image.

    Args:
        image: Pixels, shape (h, w) [DN].
        camera: Intrinsics and lens.
        noise: Noise of the sensor.
        wanted: Plates by number of their code.
        calibration: Covariance of the camera's parameters, see :data:`im_cell.camera_model.PARAMETERS`, shape (18, 18).

    Returns:
        What was found, by number, and for each of the others why it was not.
    """
    found: list[FiducialFit] = []
    missed = dict.fromkeys(wanted, "not seen: it is out of view, hidden or too small")
    quads, numbers, _ = cv2.aruco.ArucoDetector(_DICTIONARY).detectMarkers(image)
    for quad, number in zip(quads, [] if numbers is None else numbers.ravel(), strict=True):
        target = wanted.get(int(number))
        if target is None or target.id not in missed:
            continue
        try:
            corners = refine_corners(image, camera, quad.reshape(4, 2).astype(float), CELLS, noise)
        except DataError as error:
            missed[target.id] = error.message
            continue
        poses = plate_poses(corners, camera.K, target.size) if corners is not None else []
        if corners is None or not poses:
            missed[target.id] = "seen, but its edges are not straight or not clear enough"
            continue
        ideal = (corners.uv - camera.K[:2, 2]) @ np.linalg.inv(camera.K[:2, :2]).T
        ambiguity = float(np.sqrt(poses[0].chi2 / max(poses[1].chi2, 1e-12))) if len(poses) > 1 else 0.0
        pose = with_calibration(poses[0], corners, camera, target.size, calibration)
        found.append(FiducialFit(target, pose, camera.through_lens(ideal), ambiguity))
        del missed[target.id]
    return sorted(found, key=lambda fit: fit.target.id), missed
