"""Fiducial plates in an image: the corners by the edges, and the poses by the corners."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from im_cell.camera_model import CameraModel
from im_cell.fiducial import CELLS, code_of
from im_cell.robot import Target
from im_cell.rotations import cross_matrix, matrix_of_vector
from im_cell.sensor import SensorNoise
from im_core.errors import DataError
from im_vss.edges.step import Image, StraightEdge, follow_edge, undistorted_by_parameters

Array = NDArray[np.float64]

_UNCLEAR = "seen, but its edges are not straight or not clear enough"
_MARGIN_SHARE = 0.12
_WINDOW_BLURS, _WIDEST_BLUR_PX = 1.5, 2.5
_GROWTH_PX, _CELL_MARGIN, _STEP_PX = 0.5, 0.3, 1e-3
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


def refine_corners(image: Image, camera: CameraModel, rough: Array, number: int, noise: SensorNoise) -> Corners:
    """Fit and intersect the four edges of the black square of a fiducial on white.

    Args:
        image: Pixels, shape (h, w) [DN].
        camera: Intrinsics and lens.
        rough: Corners as detected, clockwise, shape (4, 2) [px].
        number: Number of the code.
        noise: Noise of the sensor.

    Returns:
        The corners in the same order.

    Raises:
        DataError: An edge cannot be fitted, is too blurred, or the lens model cannot be inverted there.
    """
    edges: list[StraightEdge] = []
    for k in range(4):
        ends = rough[[k, (k + 1) % 4]]
        length = float(np.linalg.norm(ends[1] - ends[0]))
        half = max(_SMALLEST_HALF_PX, _CELLS_HALF * length / CELLS)
        edge = follow_edge(image, camera, ends, half, _MARGIN_SHARE * length, noise)
        if edge is None:
            raise DataError(_UNCLEAR)
        if edge.fit.sigma > min(half / _WINDOW_BLURS, _WIDEST_BLUR_PX):
            raise DataError(
                f"seen, but blurred by {edge.fit.sigma:.1f} px, too much for cells of {length / CELLS:.1f} px: "
                "it or the camera moves, or it is out of focus"
            )
        edges.append(edge)
    uv, growth, jacobian, covariance = np.zeros((4, 2)), np.zeros((4, 2)), np.zeros((8, 8)), np.zeros((8, 8))
    for k in range(4):
        first, second = (k - 1) % 4, k
        normals = np.stack([edges[first].normal, edges[second].normal])
        uv[k] = np.linalg.solve(normals, [n @ edges[e].middle for n, e in zip(normals, (first, second), strict=True)])
        inverse = np.linalg.inv(normals)
        growth[k] = -inverse.sum(axis=1)
        for column, e in enumerate((first, second)):
            arm = float((uv[k] - edges[e].middle) @ edges[e].direction)
            jacobian[2 * k : 2 * k + 2, 2 * e : 2 * e + 2] = np.outer(inverse[:, column], [1.0, arm])
        covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = edges[k].fit.covariance
    return _without_growth(image, camera, Corners(uv, jacobian @ covariance @ jacobian.T), growth, number, noise)


def _without_growth(
    image: Image, camera: CameraModel, corners: Corners, growth: Array, number: int, noise: SensorNoise
) -> Corners:
    """Free corners from the growth of bright areas, of a sensor whose values are not in proportion to the light.

    A black square looks smaller to a sensor with a gamma above 1, and so farther away, with perfectly straight edges.
    The white cells of the code look larger by as much, at places that the corners predict: corners and growth are the
    least-squares solution of all edges. Without any cell the growth has a standard deviation of 0.5 px. Edges that
    disagree by more than noise widen the covariance, as those of an image that motion has blurred do.

    Args:
        image: Pixels, shape (h, w) [DN].
        camera: Intrinsics and lens.
        corners: As the outer edges meet.
        growth: How they move where bright areas look larger by a pixel on each side, shape (4, 2) [px].
        number: Number of the code.
        noise: Noise of the sensor.

    Returns:
        The corners, with the uncertainty of the growth in their covariance.

    Raises:
        DataError: The lens model cannot be inverted there.
    """
    cell = float(np.linalg.norm(corners.uv - np.roll(corners.uv, 1, axis=0), axis=1).mean()) / CELLS
    half = max(_SMALLEST_HALF_PX, _CELLS_HALF * cell)
    rows, seen, weights = [np.append(np.zeros(8), 1.0)], [0.0], [_GROWTH_PX**-2]
    edges = np.array(_cell_edges(number))
    middles, rough = edges.mean(axis=1), _in_image(camera, _of_grid(corners.uv, edges))
    before = _of_grid(corners.uv, middles)
    moved = [_of_grid(corners.uv + step, middles) - before for step in _STEP_PX * np.eye(8).reshape(8, 4, 2)]
    for ends, middle, by_corner in zip(rough, before, np.stack(moved, axis=1) / _STEP_PX, strict=True):
        edge = follow_edge(image, camera, ends, half, _CELL_MARGIN * cell, noise)
        if edge is None:
            continue
        rows.append(np.append(-by_corner @ edge.normal, 1.0))
        seen.append(float((middle - edge.middle) @ edge.normal))
        weights.append(1.0 / edge.fit.covariance[0, 0])
    by_cells, by_corners = np.array(rows), np.column_stack((np.eye(8), growth.ravel()))
    weighted = by_cells.T * np.array(weights)
    information = by_corners.T @ np.linalg.solve(corners.covariance, by_corners) + weighted @ by_cells
    covariance = np.linalg.inv(information)
    solution = covariance @ weighted @ np.array(seen)
    by_noise = by_corners @ solution
    misfit = float(by_noise @ np.linalg.solve(corners.covariance, by_noise))
    misfit += float(np.array(weights) @ (np.array(seen) - by_cells @ solution) ** 2)
    widened = covariance * max(1.0, misfit / len(seen))  # as many more equations than unknowns
    return replace(corners, uv=corners.uv + solution[:8].reshape(4, 2), covariance=widened[:8, :8])


def _cell_edges(number: int) -> list[Array]:
    """Return the ends of the edges between white and black cells, in cells from the upper left, shape (2, 2) each."""
    code = code_of(number).astype(int)
    edges = []
    for upright, cells in ((True, code), (False, code.T)):
        for line, step in enumerate(np.diff(cells, axis=1).T, start=1):
            bounds = [0, *(np.flatnonzero(np.diff(step)) + 1), CELLS]
            for start, end in pairwise(bounds):
                if step[start]:
                    ends = np.array([[line, start], [line, end]], dtype=float)
                    edges.append(ends if upright else ends[:, ::-1])
    return edges


def _of_grid(corners: Array, places: Array) -> Array:
    """Return where places of the plate, shape (..., 2) [cells from the upper left], are by its corners [px]."""
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = corners  # Heckbert, "Fundamentals of texture mapping" (1989), 2.2.3
    dx, dy = (x0 - x1 + x2 - x3, x1 - x2, x3 - x2), (y0 - y1 + y2 - y3, y1 - y2, y3 - y2)
    g, h = np.linalg.solve([[dx[1], dx[2]], [dy[1], dy[2]]], [dx[0], dy[0]])
    homography = np.array(
        [[x1 - x0 + g * x1, x3 - x0 + h * x3, x0], [y1 - y0 + g * y1, y3 - y0 + h * y3, y0], [g, h, 1.0]]
    )
    seen = np.concatenate((places / CELLS, np.ones((*places.shape[:-1], 1))), axis=-1) @ homography.T
    return np.asarray(seen[..., :2] / seen[..., 2:])


def _in_image(camera: CameraModel, undistorted_pixels: Array) -> Array:
    """Return where in the image undistorted pixels are, shape (..., 2) [px]."""
    return camera.through_lens((undistorted_pixels - camera.K[:2, 2]) @ np.linalg.inv(camera.K[:2, :2]).T)


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
    images: Sequence[Image],
    camera: CameraModel,
    noise: SensorNoise,
    wanted: Mapping[int, Target],
    calibration: Array,
) -> tuple[list[FiducialFit], dict[int, str]]:
    """Find plates in images that a camera at rest took one after another.

    Args:
        images: Pixels, shape (h, w) [DN] each.
        camera: Intrinsics and lens.
        noise: Noise of the sensor.
        wanted: Plates by number of their code.
        calibration: Covariance of the camera's parameters, see :data:`im_cell.camera_model.PARAMETERS`, shape (18, 18).

    Returns:
        What was found, by number, and for each of the others why it was not.
    """
    found: list[FiducialFit] = []
    missed = dict.fromkeys(wanted, "not seen: it is out of view, hidden or too small")
    seen: dict[int, list[Corners]] = {}
    detector = cv2.aruco.ArucoDetector(_DICTIONARY)
    for image in images:
        quads, numbers, _ = detector.detectMarkers(image)
        once: dict[int, Corners] = {}
        for quad, code in zip(quads, [] if numbers is None else numbers.ravel(), strict=True):
            number = int(code)
            if number in wanted and number not in once:
                try:
                    once[number] = refine_corners(image, camera, quad.reshape(4, 2).astype(float), number, noise)
                except DataError as error:
                    missed[number] = error.message
        for number, corners in once.items():
            seen.setdefault(number, []).append(corners)
    for number, each in sorted(seen.items()):
        target, corners = wanted[number], mean_corners(each)
        poses = plate_poses(corners, camera.K, target.size)
        if not poses:
            missed[number] = _UNCLEAR
            continue
        ambiguity = float(np.sqrt(poses[0].chi2 / max(poses[1].chi2, 1e-12))) if len(poses) > 1 else 0.0
        pose = with_calibration(poses[0], corners, camera, target.size, calibration)
        found.append(FiducialFit(target, pose, _in_image(camera, corners.uv), ambiguity))
        del missed[number]
    return found, missed


def mean_corners(seen: Sequence[Corners]) -> Corners:
    """Return the mean of the corners in several images, by their covariances.

    Images that disagree by more than noise, as of a camera that is not at rest, widen the covariance.
    """
    information = [np.linalg.inv(each.covariance) for each in seen]
    covariance = np.linalg.inv(np.sum(information, axis=0))
    weighted = [by @ each.uv.ravel() for by, each in zip(information, seen, strict=True)]
    uv = covariance @ np.sum(weighted, axis=0)
    off = [each.uv.ravel() - uv for each in seen]
    misfit = sum(float(each @ by @ each) for by, each in zip(information, off, strict=True))
    return Corners(uv.reshape(4, 2), covariance * max(1.0, misfit / max(1, 8 * (len(seen) - 1))))
