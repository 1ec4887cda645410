"""A start for each camera from nothing: direct linear transformation, made robust by RANSAC.

Source: Hartley and Zisserman, "Multiple View Geometry", 2nd ed., sections 7.1 (DLT) and 6.2.4 (decomposition).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from im_calibration.errors import DegenerateDataError, InconsistentDataError
from im_calibration.estimation.unknowns import ParameterLayout, Unknowns, lens_reach, rotation_exp
from im_calibration.problem.problem import CalibrationProblem
from im_cell.lens import EQUIDISTANT

Array = NDArray[np.float64]

_SAMPLES = 400
_SAMPLE_SIZE = 7
_SEED = 1989
_REFITS, _REFITTED = 6, 20
_REWEIGHTINGS = 15
_FOCAL_LENGTHS = (0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0)
FLAT = 0.02
"""Thickness over length of a cloud of positions below which it counts as a plane."""
_THIN = 0.02
_POINT_M, _SPOT_PX = 1e-6, 1.0
"""Places nearer to each other are the same: no noise is so small that they tell of a camera."""
_WIDEST_ANGLES = (0.3, 0.45, 0.6, 0.75, 0.9, 1.05, 1.2, 1.35, 1.5, 1.7, 1.9)
_PINHOLE_ANGLE = 1.2
_CORE_SHARE, _CORE_ROUNDS = 0.85, 6


@dataclass(frozen=True)
class PinholeStart:
    """A camera without distortion.

    Attributes:
        intrinsics: fx, fy, cx, cy [px].
        rotation: Rotation base -> camera, shape (3, 3).
        translation: Base origin in the camera frame, shape (3,) [m].
    """

    intrinsics: Array
    rotation: Array
    translation: Array


def start(problem: CalibrationProblem, layout: ParameterLayout, offsets: Unknowns | None = None) -> Unknowns:
    """Start values of all unknowns, distortion at zero.

    Args:
        problem: The observations, in canonical order if the result shall not depend on the order.
        layout: Which unknowns there are.
        offsets: Where to take LED and joint offsets from; None: their prior means.

    Raises:
        DegenerateDataError: A camera has too few spots, or the positions lie on a line.
        InconsistentDataError: No camera explains the spots.
    """
    points = problem.positions if offsets is None else offsets.robot_positions(problem)
    known = 0.0 if offsets is None else 0.8
    cameras = [_start_camera(problem, c, points, known) for c in range(len(problem.camera_names))]
    intrinsics = np.zeros((len(cameras), 4 + max(lens.estimated for lens in layout.lenses)))
    intrinsics[:, :4] = [camera.intrinsics for camera in cameras]
    return Unknowns(
        layout.lenses,
        intrinsics,
        np.array([camera.rotation for camera in cameras]),
        np.array([camera.translation for camera in cameras]),
        np.zeros(3) if offsets is None else offsets.led_offset,
        np.zeros(layout.joints) if offsets is None else offsets.joint_offsets,
        np.zeros_like(problem.positions),
        np.zeros(layout.arm),
        np.zeros(layout.shared),
        no_placements(layout.placed // 6),
    )


def no_placements(count: int) -> Array:
    """Return the placements of targets that are where the positions have them, shape (count, 3, 4)."""
    return np.tile(np.eye(3, 4), (count, 1, 1))


def _start_camera(problem: CalibrationProblem, c: int, positions: Array, known: float) -> PinholeStart:
    name, seen = problem.camera_names[c], problem.detected[c]
    width, height = problem.image_sizes[c]
    everything = tuple(f"{name}.{group}" for group in ("intrinsics", "distortion", "pose"))
    fewest = int(problem.fewest_spots[c])
    if seen.sum() < fewest:
        raise DegenerateDataError(
            f"Camera {name} saw the LED in {int(seen.sum())} poses, at least {fewest} are needed.",
            "Add poses in its view, or leave the camera out.",
            parameters=everything,
            camera=name,
            spots=int(seen.sum()),
        )
    points, pixels = positions[seen], problem.spots[c][seen]
    extent = core_extent(points)
    if robust_extent(pixels)[0] < _SPOT_PX:
        raise DegenerateDataError(
            f"Camera {name} saw the LED in all poses at one place of its image, within {_SPOT_PX:g} px.",
            "Spread the poses over a volume, and check that the camera's images change.",
            parameters=everything,
            camera=name,
        )
    if extent[1] <= max(_THIN * extent[0], _POINT_M):
        raise DegenerateDataError(
            f"The LED positions seen by {name} lie on a line or in a point.",
            "Spread the poses over a volume.",
            parameters=everything,
            camera=name,
        )
    tolerance = _pixel_tolerance(problem, c, points, pixels, 1.0 - known)
    lens = problem.lenses[c]
    if extent[2] < FLAT * extent[0]:
        found = planar_start(points, pixels, (width, height), tolerance)  # linear equations of a plane are singular
    elif lens is EQUIDISTANT:
        found = fisheye_start(points, pixels, (width, height), tolerance)
    else:
        pinhole = _ransac(points.tobytes(), pixels.tobytes(), tolerance, width)
        found = pinhole or affine_start(points, pixels, (width, height), tolerance)
    if found is None and extent[2] < FLAT * extent[0]:
        raise DegenerateDataError(
            f"The LED positions seen by {name} lie in a plane, and no camera was found.",
            "Vary the height of the poses.",
            parameters=everything,
            camera=name,
        )
    if found is None:
        raise InconsistentDataError(f"No camera explains where {name} saw the LED.", camera=name)
    camera = PinholeStart(*found)
    return camera if lens is EQUIDISTANT else _centred(camera, (width, height))  # a long lens hides its principal point


def _centred(camera: PinholeStart, image_size: tuple[int, int]) -> PinholeStart:
    """Return the camera of a long lens, turned to place the principal point in the middle of the image.

    A long lens shows hardly more of the principal point than a turn of the camera does, so that linear equations find
    it anywhere, and no descent finds back from there.
    """
    fx, fy, cx, cy = camera.intrinsics
    if lens_reach(fx, image_size) == 1.0:
        return camera
    middle = (np.array(image_size) - 1.0) / 2.0
    x, y = (middle - (cx, cy)) / (fx, fy)
    slope = float(np.hypot(x, y))
    turn = rotation_exp(np.array([[y, -x, 0.0]]) * (np.arctan(slope) / max(slope, 1e-300)))[0]
    return PinholeStart(np.array([fx, fy, *middle]), turn @ camera.rotation, turn @ camera.translation)


def robust_extent(points: Array) -> Array:
    """Return standard deviations of points without the farthest fifth, by principal axis, largest first, shape (d,)."""
    distance = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    core = points[distance <= np.quantile(distance, 0.8)]
    values = np.linalg.eigvalsh(np.cov((core - core.mean(axis=0)).T, ddof=0))
    return np.asarray(np.sqrt(np.maximum(values[::-1], 0.0)))


def core_extent(points: Array) -> Array:
    """Return standard deviations of points near most points' line or plane, other points ignored, shape (3,) [m]."""
    core = points
    for _ in range(_CORE_ROUNDS):
        centre = core.mean(axis=0)
        values, axes = np.linalg.eigh(np.cov((core - centre).T, ddof=0))
        across = (points - centre) @ axes / np.sqrt(np.maximum(values, max(1e-9 * values[-1], 1e-300)))
        distance = np.linalg.norm(across, axis=1)
        core = points[distance <= np.quantile(distance, _CORE_SHARE)]
    values = np.linalg.eigvalsh(np.cov((core - core.mean(axis=0)).T, ddof=0))
    return np.asarray(np.sqrt(np.maximum(values[::-1], 0.0)))


def _pixel_tolerance(problem: CalibrationProblem, c: int, points: Array, pixels: Array, unknown: float) -> float:
    """Return the deviation from a pinhole camera due to distortion, noise and unknown share of the offsets [px]."""
    pixels_per_metre = np.median(np.abs(pixels - np.median(pixels, axis=0))) / max(
        1e-9, float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))
    )
    offset = problem.led_offset_prior_sd
    if problem.joint_jacobians is not None:
        offset = np.hypot(offset, problem.joint_offset_prior_sd * float(np.abs(problem.joint_jacobians).mean()) * 2.0)
    position = np.sqrt(np.trace(problem.position_covariances, axis1=1, axis2=2).mean() / 3.0)
    image = np.sqrt(np.nanmedian(np.trace(problem.spot_covariances[c], axis1=1, axis2=2)) / 2.0)
    lens = 0.008 * problem.image_sizes[c][0]
    spread = (2.0 * pixels_per_metre) ** 2 * ((unknown * offset) ** 2 + position**2)
    return float(np.sqrt(lens**2 + 2.0 * spread + 2.0 * image**2))


@lru_cache(maxsize=64)  # other lenses, other wrists, more rounds: often the same positions and spots begin again
def _ransac(places: bytes, spots: bytes, tolerance: float, width: float) -> tuple[Array, Array, Array] | None:
    """Return the best pinhole camera over random samples, refitted to the agreeing points."""
    points, pixels = np.frombuffer(places).reshape(-1, 3), np.frombuffer(spots).reshape(-1, 2)
    order = np.lexsort((*pixels.T, *points.T))
    points, pixels = points[order], pixels[order]
    keys = np.random.default_rng(_SEED).random((_SAMPLES, len(points)))
    samples = np.argsort(keys, axis=1)[:, :_SAMPLE_SIZE]
    candidates = _dlt(points[samples], pixels[samples], np.ones(samples.shape))
    squared = _squared_errors(candidates, points, pixels)
    costs = (squared / (squared + tolerance**2)).sum(axis=1)
    matrices = candidates[np.argsort(costs, kind="stable")[:_REFITTED]]
    each = (len(matrices), len(points))
    for _ in range(_REFITS):
        weights = (1.0 + _squared_errors(matrices, points, pixels) / tolerance**2) ** -2
        matrices = _dlt(np.broadcast_to(points, (*each, 3)), np.broadcast_to(pixels, (*each, 2)), weights)
    for matrix in matrices:
        camera = _decompose(matrix, points)
        if camera is not None and 0.2 * width < min(camera[0][:2]) and max(camera[0][:2]) < 20.0 * width:
            return camera
    return None


def _dlt(points: Array, pixels: Array, weights: Array) -> Array:
    """Projection matrices (b, 3, 4) of b weighted sets of points (b, m, 3), pixels (b, m, 2) and weights (b, m)."""
    point_mean, pixel_mean = points.mean(axis=1, keepdims=True), pixels.mean(axis=1, keepdims=True)
    point_scale = np.sqrt(3.0) / np.maximum(np.linalg.norm(points - point_mean, axis=2).mean(axis=1), 1e-9)
    pixel_scale = np.sqrt(2.0) / np.maximum(np.linalg.norm(pixels - pixel_mean, axis=2).mean(axis=1), 1e-9)
    x = np.concatenate(((points - point_mean) * point_scale[:, None, None], np.ones((*points.shape[:2], 1))), axis=2)
    u = (pixels - pixel_mean) * pixel_scale[:, None, None]
    rows = np.zeros((*points.shape[:2], 2, 12))
    rows[..., 0, 0:4] = rows[..., 1, 4:8] = x
    rows[..., 8:12] = -u[..., None] * x[:, :, None, :]
    rows *= np.sqrt(weights)[..., None, None]
    stacked = rows.reshape(len(points), -1, 12)
    matrices = np.linalg.eigh(np.swapaxes(stacked, 1, 2) @ stacked)[1][:, :, 0].reshape(-1, 3, 4)
    normalise = np.zeros((len(points), 4, 4))
    normalise[:, [0, 1, 2], [0, 1, 2]] = point_scale[:, None]
    normalise[:, :3, 3] = -point_mean[:, 0] * point_scale[:, None]
    normalise[:, 3, 3] = 1.0
    restore = np.zeros((len(points), 3, 3))
    restore[:, [0, 1], [0, 1]] = 1.0 / pixel_scale[:, None]
    restore[:, :2, 2] = pixel_mean[:, 0]
    restore[:, 2, 2] = 1.0
    return np.asarray(restore @ matrices @ normalise)


def _squared_errors(matrices: Array, points: Array, pixels: Array) -> Array:
    """Squared reprojection errors of b matrices, shape (b, m) [px^2]; huge where the depth changes sign."""
    image = points @ np.swapaxes(matrices[:, :, :3], 1, 2) + matrices[:, None, :, 3]
    depth = image[..., 2]
    sign = np.sign(np.median(depth, axis=1, keepdims=True))
    good = depth * sign > 1e-12
    errors = image[..., :2] / np.where(good, depth, 1.0)[..., None] - pixels
    return np.where(good, (errors**2).sum(axis=-1), 1e12)


def _decompose(matrix: Array, points: Array) -> tuple[Array, Array, Array] | None:
    """Return intrinsics fx, fy, cx, cy, rotation and translation of a projection matrix; None if not a camera."""
    if np.median(points @ matrix[2, :3] + matrix[2, 3]) < 0.0:
        matrix = -matrix
    if np.linalg.det(matrix[:, :3]) <= 0.0:
        return None
    q, r = np.linalg.qr(np.flipud(matrix[:, :3]).T)
    K, rotation = np.fliplr(np.flipud(r.T)), np.flipud(q.T)
    signs = np.where(np.diag(K) < 0.0, -1.0, 1.0)
    K, rotation = K * signs, signs[:, None] * rotation
    if min(abs(np.diag(K))) < 1e-12 or np.linalg.det(rotation) < 0.0:
        return None
    translation = np.linalg.solve(K, matrix[:, 3])
    K = K / K[2, 2]
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]]), rotation, translation


def affine_start(
    points: Array, pixels: Array, image_size: tuple[int, int], tolerance: float
) -> tuple[Array, Array, Array] | None:
    """Orientation and scale from the affine camera, which has 8 unknowns only; then the likeliest focal length.

    Args:
        points: Positions that fill a volume, shape (m, 3) [m].
        pixels: Their images, shape (m, 2) [px].
        image_size: Width and height [px].
        tolerance: Deviation that counts as small [px].

    Returns:
        fx, fy, cx, cy, rotation and translation; None if there is no such camera.
        Source: Hartley and Zisserman, "Multiple View Geometry", 2nd ed., sections 6.3 and 7.3.
    """
    linear, centre, image = _affine_camera(points, pixels, tolerance)
    u, values, vt = np.linalg.svd(linear, full_matrices=False)
    if values[1] < 1e-9:  # seen edge-on: one direction of the image has no extent
        return None
    rows = u @ vt  # the closest two rows of a rotation
    rotation = np.vstack((rows, np.cross(rows[0], rows[1])))
    middle = (np.array(image_size) - 1.0) / 2.0
    best, found = np.inf, None
    for focal in image_size[0] * np.array(_FOCAL_LENGTHS):
        depth = focal / values.mean()
        translation = depth * np.append((image - middle) / focal, 1.0) - rotation @ centre
        in_camera = points @ rotation.T + translation
        ahead = in_camera[:, 2] > 0.1 * depth
        predicted = focal * in_camera[:, :2] / np.where(ahead, in_camera[:, 2], 1.0)[:, None] + middle
        squared = np.where(ahead, ((predicted - pixels) ** 2).sum(axis=1), np.inf)
        # bounded for each spot, so that outliers do not choose the focal length
        cost = float((1.0 - 1.0 / (1.0 + squared / tolerance**2)).sum())
        if cost < best:
            best, found = cost, (np.array([focal, focal, *middle]), rotation, translation)
    return found


def _affine_camera(points: Array, pixels: Array, tolerance: float) -> tuple[Array, Array, Array]:
    """Return a robust linear map of points to pixels about centres: matrix (2, 3) [px/m], centre [m], centre [px]."""
    weights = np.ones(len(points))
    linear, centre, image = np.zeros((2, 3)), points.mean(axis=0), pixels.mean(axis=0)
    for _ in range(_REWEIGHTINGS):
        share = weights / weights.sum()
        centre, image = share @ points, share @ pixels
        root = np.sqrt(weights)[:, None]
        linear = np.linalg.lstsq(root * (points - centre), root * (pixels - image), rcond=None)[0].T
        squared = ((pixels - image - (points - centre) @ linear.T) ** 2).sum(axis=1)
        scale = max(tolerance**2, 4.0 * float(np.median(squared)))
        weights = (1.0 + squared / scale) ** -2
    return linear, centre, image


def fisheye_start(
    points: Array, pixels: Array, image_size: tuple[int, int], tolerance: float
) -> tuple[Array, Array, Array] | None:
    """Pose and focal length of an equidistant lens: linear equations for each of several focal lengths, the best wins.

    Args:
        points: Positions that fill a volume, shape (m, 3) [m].
        pixels: Their images, shape (m, 2) [px].
        image_size: Width and height [px].
        tolerance: Deviation that counts as small [px].

    Returns:
        fx, fy, cx, cy, rotation and translation; None if there is no such camera.
    """
    middle = (np.array(image_size) - 1.0) / 2.0
    off = pixels - middle
    radius = np.linalg.norm(off, axis=1)
    best, found = np.inf, None
    for widest in _WIDEST_ANGLES:
        focal = float(np.hypot(*middle)) / widest
        angle = radius / focal
        near = angle < _PINHOLE_ANGLE  # farther out, pixels of a pinhole camera are too far out for linear equations
        ideal = focal * off * (np.tan(np.minimum(angle, _PINHOLE_ANGLE)) / np.maximum(radius, 1e-9))[:, None]
        if near.sum() < _SAMPLE_SIZE:
            continue
        camera = _ransac(points[near].tobytes(), (ideal[near] + middle).tobytes(), tolerance, focal)
        if camera is None:
            continue
        _, rotation, translation = camera
        in_camera = points @ rotation.T + translation
        across = np.linalg.norm(in_camera[:, :2], axis=1)
        scale = np.arctan2(across, in_camera[:, 2]) / np.maximum(across, 1e-12)
        squared = ((in_camera[:, :2] * (focal * scale)[:, None] + middle - pixels) ** 2).sum(axis=1)
        cost = float((squared / (squared + tolerance**2)).sum())
        if cost < best:
            best, found = cost, (np.array([focal, focal, *middle]), rotation, translation)
    return found


def planar_start(
    points: Array, pixels: Array, image_size: tuple[int, int], tolerance: float
) -> tuple[Array, Array, Array] | None:
    """Pose and focal length from the homography of the plane, with the principal point in the middle of the image.

    Args:
        points: Nearly coplanar positions, shape (m, 3) [m].
        pixels: Their images, shape (m, 2) [px].
        image_size: Width and height [px].
        tolerance: Deviation that counts as small [px].

    Returns:
        fx, fy, cx, cy, rotation and translation; None if there is no such camera.
        Source: Zhang, "A flexible new technique for camera calibration" (2000), section 3.1.
    """
    centre = points.mean(axis=0)
    axes = np.linalg.svd(points - centre)[2]
    if np.linalg.det(axes) < 0.0:
        axes[2] = -axes[2]
    flat = (points - centre) @ axes[:2].T
    middle = (np.array(image_size) - 1.0) / 2.0
    width = float(image_size[0])
    homography = _homography(flat, (pixels - middle) / width, tolerance / width)
    focal = _focal_length(homography)
    columns = np.linalg.solve(np.diag([focal, focal, 1.0]), homography)
    scale = (np.linalg.norm(columns[:, 0]) + np.linalg.norm(columns[:, 1])) / 2.0
    if not np.isfinite(scale) or scale < 1e-12:
        return None
    columns = columns / scale * (1.0 if columns[2, 2] > 0.0 else -1.0)
    u, _, vt = np.linalg.svd(np.column_stack((columns[:, 0], columns[:, 1], np.cross(columns[:, 0], columns[:, 1]))))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt @ axes
    translation = columns[:, 2] - rotation @ centre
    if np.median(points @ rotation[2] + translation[2]) <= 0.0:
        return None
    return np.array([focal * width, focal * width, *middle]), rotation, translation


def _homography(flat: Array, image: Array, tolerance: float) -> Array:
    """Homography plane -> image by reweighted direct linear transformation, shape (3, 3)."""
    weights, homography = np.ones(len(flat)), np.eye(3)
    plane = np.column_stack((flat, np.ones(len(flat))))
    for _ in range(_REWEIGHTINGS):
        rows = np.zeros((len(flat), 2, 9))
        rows[:, 0, 0:3] = rows[:, 1, 3:6] = plane
        rows[:, :, 6:9] = -image[:, :, None] * plane[:, None, :]
        rows *= np.sqrt(weights)[:, None, None]
        homography = np.linalg.svd(rows.reshape(-1, 9))[2][-1].reshape(3, 3)
        mapped = plane @ homography.T
        depth = np.where(np.abs(mapped[:, 2]) > 1e-12, mapped[:, 2], 1e-12)
        squared = ((mapped[:, :2] / depth[:, None] - image) ** 2).sum(axis=1)
        scale = max(tolerance**2, 4.0 * float(np.median(squared)))
        weights = (1.0 + squared / scale) ** -2
    return np.asarray(homography)


def _focal_length(homography: Array) -> float:
    """Return the focal length in image widths from the two constraints of a plane; 1 without a result in 0.3 ... 5."""
    h1, h2 = homography[:, 0], homography[:, 1]
    left = np.array([h1[2] * h2[2], h1[2] ** 2 - h2[2] ** 2])
    right = -np.array([h1[:2] @ h2[:2], h1[:2] @ h1[:2] - h2[:2] @ h2[:2]])
    square = float(left @ right) / max(float(left @ left), 1e-300)
    return float(np.sqrt(square)) if 0.09 < square < 25.0 else 1.0
