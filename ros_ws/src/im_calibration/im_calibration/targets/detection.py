"""Points of a target in an image: found by OpenCV, then refined where squares meet.

Around a point where two dark squares meet, the image is ``m + a E(d1 / s) E(d2 / s)``, with E the error function, d1
and d2 the distances from the two edges, and s the blur. The image is the same when turned by half about the point,
whatever the blur and the gamma of the sensor, so that neither moves the fitted point. Compare Chen and Zhang, "A new
sub-pixel detector for x-corners in camera calibration targets" (2005), who fit the saddle of the blurred image.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from im_calibration.recorded.image_message import Image
from im_calibration.targets.target import DICTIONARIES, FEWEST_POINTS, STANDARD_TAGS, CalibrationTarget
from im_core.errors import DataError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_FEW_MARKERS, _MOST_MARKERS = 3, 100
_FEWEST_SIDE = 3
_MANY, _REWEIGHTINGS, _DETECTED_PX = 24, 6, 4.0
_SHARE_OF_SQUARE, _LEAST_HALF, _LARGEST_HALF = 0.42, 3, 9
_FIT_STEPS, _MOST_MOVED_PX, _CONTRAST = 8, 1.5, 4.0
_MODEL_PX = 0.005  # a pixel is a square, and edges behind a lens are bent
_BLURS = (0.3, 4.0)
_MISPLACED = 0.3  # of the side of a square: no lens bends so much


@dataclass(frozen=True)
class Detection:
    """Points of a target in one image.

    Attributes:
        points: Where, NaN where not found, shape (p, 2) [px].
        standard_deviations: Of each coordinate by the noise of the image, NaN where not known, shape (p,) [px].
    """

    points: Array
    standard_deviations: Array

    @property
    def count(self) -> int:
        """How many points were found."""
        return int(np.isfinite(self.points[:, 0]).sum())


def detect(image: Image, target: CalibrationTarget) -> Detection | None:
    """Find a target in an image.

    Args:
        image: Grey image of 8 or 16 bits, shape (height, width).
        target: The target.

    Returns:
        Its points; None: it was not found, or with fewer than 8 points, or as a part of a larger chessboard.

    Raises:
        DataError: The image is no grey image.
    """
    if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        raise DataError(f"An image has shape {image.shape} of {image.dtype}, a grey image of 8 or 16 bits is needed.")
    grey = np.asarray(image, dtype=np.uint8) if image.dtype == np.uint8 else _eight_bits(image)
    finders = {"chessboard": _chessboard, "charuco": _charuco, "tags": _tags}
    points = finders.get(target.kind, _circles)(grey, target)
    if points is None or np.isfinite(points[:, 0]).sum() < FEWEST_POINTS:
        return None
    homography = _homography(target, points)
    if homography is None or _misfit(target, points) > _MISPLACED * _side(target, homography):
        return None  # as with rows and columns exchanged
    if target.kind == "chessboard":
        points, homography = _dark_first(grey, target, points, homography)
    if target.kind in ("circles", "asymmetric_circles") or target.dictionary == STANDARD_TAGS:
        return Detection(points, np.full(len(points), np.nan))
    starts = _unshrunk(target, points)[1] if target.kind == "tags" else points
    found = _refined(np.asarray(image, dtype=float), target, starts, homography)
    return found or Detection(points, np.full(len(points), np.nan))


def _eight_bits(image: Image) -> NDArray[np.uint8]:
    low, high = np.percentile(image, (0.5, 99.5))
    return np.asarray(np.clip((image - low) * (255.0 / max(high - low, 1.0)), 0.0, 255.0), dtype=np.uint8)


def _chessboard(grey: NDArray[np.uint8], target: CalibrationTarget) -> Array | None:
    size = (target.columns, target.rows)
    corners, sides = _at_least(grey, size)
    if sides is None:
        found, corners = cv2.findChessboardCorners(grey, size)
        sides = size if found else None
    if sides is None or sorted(sides) != sorted(size):
        return None
    flat = corners.reshape(-1, 2)
    apart = float(np.linalg.norm(np.diff(flat.reshape(target.rows, target.columns, 2), axis=1), axis=2).min())
    half = int(np.clip(_SHARE_OF_SQUARE * apart, _LEAST_HALF, _LARGEST_HALF))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    better = cv2.cornerSubPix(grey, np.ascontiguousarray(corners, dtype=np.float32), (half, half), (-1, -1), stop)
    return np.asarray(better, dtype=np.float64).reshape(-1, 2)


def _at_least(grey: NDArray[np.uint8], size: tuple[int, int]) -> tuple[Any, tuple[int, int] | None]:
    """Return the corners of a chessboard of at least a size, and their columns and rows; None: there is no such board.

    Of a larger board OpenCV would find any rows and columns, as each second one.
    """
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    found, corners, marks = cv2.findChessboardCornersSBWithMeta(grey, size, flags)
    return corners, (marks.shape[1], marks.shape[0]) if found else None


def chessboard_in(image: Image) -> tuple[int, int] | None:
    """Return columns and rows of the inner corners of a chessboard in a grey image, the longer side first, if any."""
    grey = np.asarray(image, dtype=np.uint8) if image.dtype == np.uint8 else _eight_bits(image)
    _, sides = _at_least(grey, (_FEWEST_SIDE, _FEWEST_SIDE))
    return sides and (max(sides), min(sides))


def _charuco(grey: NDArray[np.uint8], target: CalibrationTarget) -> Array | None:
    board = cv2.aruco.CharucoBoard((target.columns, target.rows), target.size, target.part, _dictionary(target))
    points = np.full((len(target.points), 2), np.nan)
    for legacy in (False, True):  # boards with an even number of rows changed with OpenCV 4.6
        board.setLegacyPattern(legacy)
        corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
        if ids is not None and len(ids) >= FEWEST_POINTS:
            points[np.ravel(ids)] = np.reshape(np.asarray(corners), (-1, 2))
            return points
        if target.rows % 2:
            break
    return None


def _tags(grey: NDArray[np.uint8], target: CalibrationTarget) -> Array | None:
    """Return the corners of tags; find the first corner of a tag, a matter of the maker, by trial."""
    found = _standard_tags(grey) if target.dictionary == STANDARD_TAGS else _opencv_tags(grey, target)
    if found is None:
        return None
    best, least = None, np.inf
    for turn in range(4):
        points = np.full((target.columns * target.rows, 4, 2), np.nan)
        for tag, number in zip(*found, strict=True):
            if number < len(points):
                points[number] = np.roll(tag, turn, axis=0)
        flat = points.reshape(-1, 2)
        off = _misfit(target, flat)
        if off < least:
            best, least = flat, off
        if len(points) == 1:
            break
    return best if best is None else _unshrunk(target, best)[0]


def _standard_tags(grey: NDArray[np.uint8]) -> tuple[list[Array], Array] | None:
    """Return corners, clockwise from the upper left, and numbers of AprilTags that OpenCV does not know."""
    import pupil_apriltags  # a library of 14 MB, which few targets need

    detector = pupil_apriltags.Detector(families="tagStandard41h12", quad_decimate=1.0)
    found = [tag for tag in detector.detect(np.ascontiguousarray(grey)) if tag.hamming == 0]
    if not found:
        return None
    corners = [np.asarray(tag.corners, dtype=float)[::-1] - 0.5 for tag in found]  # 0.5 is the middle of a pixel there
    return corners, np.array([tag.tag_id for tag in found])


def _opencv_tags(grey: NDArray[np.uint8], target: CalibrationTarget) -> tuple[list[Array], Array] | None:
    """Return corners and numbers of the tags of a dictionary of OpenCV."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG  # finds tags that touch dark squares
    found: tuple[list[Array], Array] | None = None
    bright = cv2.LUT(grey, np.rint(255.0 * (np.arange(256) / 255.0) ** 0.45).astype(np.uint8))
    for image, border in ((bright, 1), (grey, 1), (bright, 2)):  # Kalibr's tags have a border of two bits
        parameters.markerBorderBits = border
        corners, ids, _ = cv2.aruco.ArucoDetector(_dictionary(target), parameters).detectMarkers(image)
        if ids is not None and (found is None or len(ids) > len(found[1])):
            # this refinement has the middle of a pixel at 0.5, as its makers' library
            moved = [np.asarray(np.reshape(each, (4, 2)) - 0.5, dtype=np.float64) for each in corners]
            found = moved, np.ravel(ids)
            if len(ids) >= target.columns * target.rows:
                break
    return found


def markers_in(images: Sequence[Image]) -> tuple[str, list[int]]:
    """Return the dictionary of most of the markers in images, and the numbers; empty with fewer than four.

    Args:
        images: Grey images of 8 or 16 bits.
    """
    best, most = "", list[int]()
    greys = [np.asarray(image, dtype=np.uint8) if image.dtype == np.uint8 else _eight_bits(image) for image in images]
    for name in DICTIONARIES:
        every = CalibrationTarget("tags", _MOST_MARKERS, _MOST_MARKERS, 1.0, 1.0, name)
        seen = [_standard_tags(grey) if name == STANDARD_TAGS else _opencv_tags(grey, every) for grey in greys]
        numbers = sorted({int(number) for found in seen if found is not None for number in found[1]})
        if len(numbers) > max(len(most), _FEW_MARKERS):
            best, most = name, numbers
    return best, most


def _unshrunk(target: CalibrationTarget, points: Array) -> tuple[Array, Array]:
    """Return the corners of tags without the shrinking of dark tags, and the same points smoothed.

    Blur under the gamma or the saturation of a sensor moves all edges into the dark by about one distance, which the
    distances of tags show. Smooth is what a homography and a polynomial describe, as of a flat target behind a lens.
    """
    homography, seen = _homography(target, points), np.isfinite(points[:, 0])
    if homography is None or seen.sum() < _MANY:
        return points, points
    flat = _through(homography, target.points[:, :2])
    x, y = ((flat - flat[seen].mean(axis=0)) / np.std(flat[seen], axis=0).max()).T
    terms = np.column_stack([x**i * y**j for i in range(4) for j in range(4 - i)])
    both = np.zeros((len(points), 2, 2 * terms.shape[1] + 1))
    both[:, 0, : terms.shape[1]] = both[:, 1, terms.shape[1] : -1] = terms
    both[:, :, -1] = _inwards(flat)
    weights = np.ones(int(seen.sum()))
    off = (points - flat)[seen]
    for _ in range(_REWEIGHTINGS):
        rows = (both[seen] * weights[:, None, None]).reshape(-1, both.shape[2])
        solved, *_ = np.linalg.lstsq(rows, (off * weights[:, None]).ravel())
        left = np.linalg.norm(off - both[seen] @ solved, axis=1)
        weights = 1.0 / (1.0 + left / max(float(np.median(left)), 1e-3))
    unshrunk = points - both[:, :, -1] * solved[-1]
    smooth = flat + both[:, :, :-1] @ solved[:-1]
    near = seen & (np.linalg.norm(smooth - unshrunk, axis=1) < _DETECTED_PX)
    return unshrunk, np.where(near[:, None], smooth, points)


def _inwards(corners: Array) -> Array:
    """Return the moves of corners of tags for all edges moved inwards by one pixel, shape (p, 2)."""
    tags = corners.reshape(-1, 4, 2)
    ways = [np.roll(tags, -step, axis=1) - tags for step in (1, -1)]
    units = [way / np.linalg.norm(way, axis=2, keepdims=True) for way in ways]
    sine = np.abs(units[0][..., 0] * units[1][..., 1] - units[0][..., 1] * units[1][..., 0])
    return np.asarray(((units[0] + units[1]) / np.maximum(sine, 1e-3)[..., None]).reshape(-1, 2))


def _circles(grey: NDArray[np.uint8], target: CalibrationTarget) -> Array | None:
    shape = cv2.CALIB_CB_ASYMMETRIC_GRID if target.kind == "asymmetric_circles" else cv2.CALIB_CB_SYMMETRIC_GRID
    found, centres = cv2.findCirclesGrid(grey, (target.columns, target.rows), flags=shape)
    return centres.reshape(-1, 2).astype(float) if found else None


def _dictionary(target: CalibrationTarget) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{target.dictionary}"))


def _homography(target: CalibrationTarget, points: Array) -> Array | None:
    seen = np.isfinite(points[:, 0])
    if seen.sum() < 4:
        return None
    found, _ = cv2.findHomography(target.points[seen, :2], points[seen])
    return None if found is None else np.asarray(found, dtype=float)


def _misfit(target: CalibrationTarget, points: Array) -> float:
    homography = _homography(target, points)
    if homography is None:
        return float("inf")
    return float(np.nanmean(np.linalg.norm(_through(homography, target.points[:, :2]) - points, axis=1)))


def _side(target: CalibrationTarget, homography: Array) -> float:
    """Return how long a square, tag or distance of circles is in the middle of the image of the target [px]."""
    middle = target.points[:, :2].mean(axis=0, keepdims=True)
    return target.size * float(np.linalg.norm(_directions(homography, middle)[0], axis=0).mean())


def _through(homography: Array, flat: Array) -> Array:
    moved = np.column_stack((flat, np.ones(len(flat)))) @ homography.T
    return np.asarray(moved[:, :2] / moved[:, 2:])


def _dark_first(
    grey: NDArray[np.uint8], target: CalibrationTarget, points: Array, homography: Array
) -> tuple[Array, Array]:
    """Number the corners from the one with a dark outer square, if turning the board by half exchanges the colours.

    The numbers also run so that x, y and the view from the front are right-handed.
    """
    if np.linalg.det(_directions(homography, target.points[:1, :2])[0]) < 0.0:
        grid = points.reshape(target.rows, target.columns, 2)[:, ::-1]
        points = grid.reshape(-1, 2)
    if not target.turns_to_itself:
        found = _homography(target, points)
        homography = homography if found is None else found
        squares = np.stack(np.meshgrid(np.arange(target.columns - 1), np.arange(target.rows - 1)), axis=-1)
        middles = np.asarray(target.size * (squares.reshape(-1, 2) + 0.5), dtype=np.float64)
        u, v = np.rint(_through(homography, middles)).astype(int).T
        inside = (u >= 0) & (v >= 0) & (u < grey.shape[1]) & (v < grey.shape[0])
        dark = np.where(squares.reshape(-1, 2).sum(axis=1) % 2 == 0, 1.0, -1.0)[inside]
        if float((dark * grey[v[inside], u[inside]]).sum()) > 0.0:
            points = points[::-1]
    found = _homography(target, points)
    return points, homography if found is None else found


def _directions(homography: Array, flat: Array) -> Array:
    """Return the derivatives of image points by the target's coordinates, shape (p, 2, 2) [px/m]."""
    moved = np.column_stack((flat, np.ones(len(flat)))) @ homography.T
    pixels = moved[:, :2] / moved[:, 2:]
    return np.asarray((homography[None, :2, :2] - pixels[:, :, None] * homography[2, :2]) / moved[:, 2, None, None])


def _refined(image: Array, target: CalibrationTarget, points: Array, homography: Array) -> Detection | None:
    """Fit the model of an x-corner around each point; None: the points are no x-corners, as of tags alone."""
    seen = np.flatnonzero(np.isfinite(points[:, 0]))
    axes = _directions(homography, target.points[seen, :2])
    sides = _clear(target) * np.linalg.norm(axes, axis=1).min(axis=1)
    deviations = np.full(len(points), np.nan)
    refined = points.copy()
    for half in range(_LEAST_HALF, _LARGEST_HALF + 1):
        wanted = np.clip(np.floor(sides), _LEAST_HALF, _LARGEST_HALF) == half
        group = seen[wanted]
        if len(group):
            refined[group], deviations[group] = _fit_corners(image, points[group], axes[wanted], half)
    fitted = np.isfinite(deviations)
    if 2 * fitted.sum() < len(seen):
        return None
    refined[~fitted] = np.nan
    off = np.linalg.norm(_through(homography, target.points[:, :2]) - refined, axis=1)
    lost = np.zeros(len(points), dtype=bool)
    lost[seen] = off[seen] > _MISPLACED * target.size * np.linalg.norm(axes, axis=1).max(axis=1)
    refined[lost] = np.nan
    return Detection(refined, deviations)


def _clear(target: CalibrationTarget) -> float:
    """Return the distance from a point within which there is nothing but two edges [m]."""
    if target.kind == "charuco":
        return 0.5 * (target.size - target.part)
    if target.kind == "tags":
        return min(target.size / (_dictionary(target).markerSize + 2), target.part)
    return _SHARE_OF_SQUARE * target.size


def _fit_corners(image: Array, starts: Array, axes: Array, half: int) -> tuple[Array, Array]:
    """Fit x-corners by Gauss and Newton's method, all of a window's size at once.

    Args:
        image: The image.
        starts: Where they are about, shape (k, 2) [px].
        axes: Directions of the edges, in columns, shape (k, 2, 2).
        half: Half the side of the windows [px].

    Returns:
        Points, shape (k, 2), and standard deviations, NaN where the start was kept, shape (k,) [px].
    """
    height, width = image.shape
    centres = np.rint(starts).astype(int)
    inside = np.all((centres >= half) & (centres < np.array([width, height]) - half), axis=1)
    span = np.arange(-half, half + 1)
    dx, dy = (part.ravel().astype(float) for part in np.meshgrid(span, span))
    held = np.clip(centres, half, np.array([width, height]) - half - 1)
    values = image[(held[:, 1, None] + dy.astype(int)), (held[:, 0, None] + dx.astype(int))]
    weights = np.exp(-(dx**2 + dy**2) / (2.0 * (0.7 * half) ** 2))
    angles = np.arctan2(axes[:, 1], axes[:, 0]) + np.pi / 2.0  # of the normals of the edges
    p = np.column_stack((starts - held, angles, np.full(len(starts), 0.8)))  # u, v, two angles, blur
    m = a = np.zeros(len(starts))
    normal = np.tile(np.eye(5), (len(starts), 1, 1))
    misfit = np.full(len(starts), np.inf)
    for _ in range(_FIT_STEPS):
        x, y = dx - p[:, :1], dy - p[:, 1:2]
        cos, sin = np.cos(p[:, 2:4]), np.sin(p[:, 2:4])
        s = p[:, 4:]
        d = [cos[:, k : k + 1] * x + sin[:, k : k + 1] * y for k in (0, 1)]
        along = [-sin[:, k : k + 1] * x + cos[:, k : k + 1] * y for k in (0, 1)]
        e = [scipy.special.erf(each / (np.sqrt(2.0) * s)) for each in d]
        g = [np.exp(-0.5 * (each / s) ** 2) * np.sqrt(2.0 / np.pi) / s for each in d]
        product = e[0] * e[1]
        mean_p, mean_v = ((weights * each).sum(axis=1) / weights.sum() for each in (product, values))
        centred = product - mean_p[:, None]
        a = (weights * centred * values).sum(axis=1) / np.maximum((weights * centred**2).sum(axis=1), 1e-12)
        m = mean_v - a * mean_p
        residual = values - m[:, None] - a[:, None] * product
        slopes = [g[0] * e[1], g[1] * e[0]]
        columns = [
            -(cos[:, :1] * slopes[0] + cos[:, 1:] * slopes[1]),
            -(sin[:, :1] * slopes[0] + sin[:, 1:] * slopes[1]),
            slopes[0] * along[0],
            slopes[1] * along[1],
            -(slopes[0] * d[0] + slopes[1] * d[1]) / s,
        ]
        jacobian = a[:, None, None] * np.stack(columns, axis=-1)
        normal = np.einsum("kni,n,knj->kij", jacobian, weights, jacobian)
        gradient = np.einsum("kni,n,kn->ki", jacobian, weights, residual)
        scale = 1.0 / np.sqrt(np.maximum(np.einsum("kii->ki", normal), 1e-12))
        scaled = normal * scale[:, :, None] * scale[:, None, :] + 1e-6 * np.eye(5)
        step = scale * np.linalg.solve(scaled, (scale * gradient)[..., None])[..., 0]
        p = p + np.clip(step, -0.5, 0.5)
        p[:, 4] = np.clip(p[:, 4], *_BLURS)
        misfit = (weights * residual**2).sum(axis=1) / weights.sum()
    noise = np.sqrt(misfit)
    spread = np.linalg.inv(normal + 1e-9 * np.eye(5))
    spread = spread @ np.einsum("kni,n,knj->kij", jacobian, weights**2, jacobian) @ spread
    deviations = np.sqrt(noise**2 * np.maximum(spread[:, 0, 0] + spread[:, 1, 1], 0.0) / 2.0 + _MODEL_PX**2)
    found = p[:, :2] + held
    good = inside & (np.linalg.norm(found - starts, axis=1) < _MOST_MOVED_PX) & (np.abs(a) > _CONTRAST * noise)
    return np.where(good[:, None], found, starts), np.where(good, deviations, np.nan)
