"""Where a laser line is: one place in each row of an image, or in each column; and matched between two cameras."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from im_cell.camera_model import CameraModel
from im_cell.laser_model import LaserModel
from im_cell.link import LaserBeam
from im_cell.sensor import SensorNoise
from im_core.config import Model
from im_vss.stereo import essential_matrix

Array = NDArray[np.float64]
Frame = NDArray[np.uint8]

_REACH_SIGMAS = 4.0
_RIVAL_PX = 6
_NEIGHBOURS_PX = 4.0
FARTHEST_M = 8.0
"""How far from a camera a point of the line may be."""


class LaserLineGates(Model):
    """Limits of a place on a line.

    Attributes:
        sigma: Width of a line [px].
        snr: Least response of the matched filter [-].
        rival_ratio: A second place this bright, relative to the first, makes a row ambiguous [-].
        edge: Nearest a place may be to the edge of the image [px].
    """

    sigma: float = Field(gt=0.3)
    snr: float = Field(ge=5.0)
    rival_ratio: float = Field(gt=0.0, le=1.0)
    edge: float = Field(ge=1.0)


@dataclass(frozen=True)
class LinePeaks:
    """Places of a line.

    Attributes:
        pixels: Shape (n, 2) [px].
        brightness: Of each, shape (n,) [DN].
        rejected: Rows without a place although there is light, by cause.
    """

    pixels: Array
    brightness: Array
    rejected: dict[str, int]


def line_peaks(on: Frame, off: Frame, upright: bool, noise: SensorNoise, gates: LaserLineGates) -> LinePeaks:
    """Find a line in the difference of two frames, by a matched filter along each row and a parabola at the top.

    Args:
        on: Frame with the line, shape (h, w) [DN].
        off: Frame without it, shape (h, w) [DN].
        upright: Whether the line runs from row to row; if not, it runs from column to column.
        noise: Noise of the sensor.
        gates: What a place must be like.
    """
    if not upright:
        on, off = np.ascontiguousarray(on.T), np.ascontiguousarray(off.T)
    rows, columns = np.arange(on.shape[0]), np.arange(on.shape[1])
    response = _response(on, off, gates.sigma, noise)
    best = response.argmax(axis=1)
    snr = response[rows, best]
    lit = snr >= gates.snr
    inside = (best >= gates.edge) & (best <= on.shape[1] - 1 - gates.edge)
    middle = np.clip(best, 1, on.shape[1] - 2)
    clipped = np.stack([on[rows, middle + step] for step in (-1, 0, 1)]).max(axis=0) >= noise.saturation
    others = np.where(np.abs(columns[None] - best[:, None]) <= _RIVAL_PX, -np.inf, response).max(axis=1)
    single = others < np.maximum(gates.rival_ratio * snr, gates.snr)
    good = lit & inside & ~clipped & single
    before, here, after = (response[rows, middle + step] for step in (-1, 0, 1))
    bend = np.minimum(before - 2.0 * here + after, -1e-9)
    place = middle + np.clip(0.5 * (before - after) / bend, -1.0, 1.0)
    pixels = np.stack((place, rows), axis=1)[good].astype(float)
    bright = on[rows, middle].astype(float) - off[rows, middle]
    causes = {
        "at the edge of the image": lit & ~inside,
        "saturated": lit & inside & clipped,
        "more than one line in the row": lit & inside & ~clipped & ~single,
    }
    counts = {cause: int(which.sum()) for cause, which in causes.items() if which.any()}
    return LinePeaks(pixels if upright else pixels[:, ::-1], bright[good], counts)


def upright(camera: CameraModel, laser: LaserModel, beam: LaserBeam) -> bool:
    """Whether a line runs from row to row of the image, as seen at the depth the camera looks at."""
    starts, ways = laser.rays(
        [[beam.mirror1 - beam.half_sweep, beam.mirror2], [beam.mirror1 + beam.half_sweep, beam.mirror2]]
    )
    (u0, v0), (u1, v1) = camera.to_camera(starts + 3.0 * ways)[:, :2]
    return bool(abs(v1 - v0) >= abs(u1 - u0))


def _response(on: Frame, off: Frame, sigma: float, noise: SensorNoise) -> Array:
    """Signal-to-noise ratio of a line at each pixel, shape (h, w)."""
    reach = int(np.ceil(_REACH_SIGMAS * sigma))
    kernel = np.asarray(cv2.getGaussianKernel(2 * reach + 1, sigma, cv2.CV_32F), dtype=np.float32)
    kernel = kernel / np.sqrt((kernel**2).sum())
    background = cv2.blur(off, (3, 3)).astype(np.float32)
    whitened = cv2.subtract(on, off, dtype=cv2.CV_32F) / np.sqrt(2.0 * noise.variance(background))
    one = np.ones((1, 1), dtype=np.float32)
    return np.asarray(cv2.sepFilter2D(whitened, cv2.CV_32F, kernel, one, borderType=cv2.BORDER_CONSTANT), dtype=float)


@dataclass(frozen=True)
class LineMatches:
    """Matched places.

    Attributes:
        points: In the world, shape (k, 3) [m].
        places: Which of the first camera's places each is, shape (k,).
        rejected: Places of the first camera without a point, by cause.
    """

    points: Array
    places: NDArray[np.int64]
    rejected: dict[str, int]


def match_lines(cameras: tuple[CameraModel, CameraModel], first: Array, second: Array) -> LineMatches:
    """Triangulate a line.

    Args:
        cameras: Two, with their poses.
        first: Places of the line in the first, in order along it, shape (n, 2) [px].
        second: The same in the second, shape (m, 2) [px].

    Raises:
        DataError: The lens model cannot be inverted at a place.
    """
    x, y = (_ideal(camera, pixels) for camera, pixels in zip(cameras, (first, second), strict=True))
    side = x @ essential_matrix(*cameras).T @ y.T
    next_to = np.linalg.norm(np.diff(second, axis=0), axis=1) <= _NEIGHBOURS_PX
    crosses = (np.sign(side[:, :-1]) != np.sign(side[:, 1:])) & next_to
    count = crosses.sum(axis=1)
    places = np.flatnonzero(count == 1)
    here = crosses[places].argmax(axis=1)
    before, after = side[places, here], side[places, here + 1]
    share = (before / (before - after))[:, None]
    matched = (1.0 - share) * y[here] + share * y[here + 1]
    points = _nearest(cameras, x[places], matched)
    depths = np.array([camera.to_camera(points)[:, 2] for camera in cameras])
    seen = np.all((depths > 0.0) & (depths < FARTHEST_M), axis=0)  # what meets behind them was two other things
    causes = {
        "no match in the other camera": count == 0,
        "more than one match in the other camera": count > 1,
        f"not within {FARTHEST_M:g} m in front of both cameras": ~seen,
    }
    rejected = {cause: int(which.sum()) for cause, which in causes.items() if which.any()}
    return LineMatches(points[seen], places[seen], rejected)


def _ideal(camera: CameraModel, pixels: Array) -> Array:
    """Ideal images on the plane z = 1, shape (n, 3) [-], of pixels, shape (n, 2)."""
    return np.column_stack((camera.undistort(pixels).reshape(-1, 2), np.ones(len(pixels))))


def _nearest(cameras: tuple[CameraModel, CameraModel], x: Array, y: Array) -> Array:
    """Return points half way between pairs of rays at the nearest, shape (k, 3) [m]; rays by ideal images."""
    u, v = x @ cameras[0].R_cam_base, y @ cameras[1].R_cam_base
    base = cameras[1].position - cameras[0].position
    uu, uv, vv = (np.einsum("ni,ni->n", a, b) for a, b in ((u, u), (u, v), (v, v)))
    with np.errstate(divide="ignore", invalid="ignore"):  # parallel rays meet nowhere
        along = (vv * (u @ base) - uv * (v @ base)) / (uu * vv - uv**2)
        across = (uv * (u @ base) - uu * (v @ base)) / (uu * vv - uv**2)
    ends = cameras[0].position + along[:, None] * u, cameras[1].position + across[:, None] * v
    return np.asarray(0.5 * (ends[0] + ends[1]))
