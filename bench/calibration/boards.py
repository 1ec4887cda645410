"""Images of calibration targets with known truth: each pixel is the mean of rays through the lens onto the pattern.

Nothing of a detector is used: the pattern is a function of the place on the target, and the lens is inverted per ray.
"""

import ctypes
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import pupil_apriltags
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from im_calibration.targets.target import STANDARD_TAGS, CalibrationTarget
from im_cell.camera_model import CameraModel

Array = NDArray[np.float64]

_RAYS = 5
_DARK, _BRIGHT = 0.08, 0.85


@dataclass(frozen=True)
class Sensor:
    """How light becomes numbers.

    Attributes:
        blur: Standard deviation of the point spread [px].
        noise: Standard deviation of the noise, of full scale.
        gamma: Exponent of the sensor's curve; 1: linear.
        bits: 8 or 16.
        exposure: Factor of the light; what is above full scale is cut off.
    """

    blur: float = 0.6
    noise: float = 0.01
    gamma: float = 1.0
    bits: int = 8
    exposure: float = 1.0


def brightness(target: CalibrationTarget, place: Array, joined: bool = True) -> Array:
    """Return the brightness of places on the target, shape (..., 2) [m] -> (...); bright around the pattern.

    Args:
        target: The target.
        place: The places.
        joined: Whether there are dark squares between the corners of tags.
    """
    x, y = place[..., 0], place[..., 1]
    size, columns, rows = target.size, target.columns, target.rows
    if target.kind == "chessboard":
        i, j = np.floor(x / size).astype(int) + 1, np.floor(y / size).astype(int) + 1
        inside = (i >= 0) & (j >= 0) & (i <= columns) & (j <= rows)
        return np.where(inside & ((i + j) % 2 == 0), _DARK, _BRIGHT)
    if target.kind in ("circles", "asymmetric_circles"):
        radius = 0.3 * size * (1.0 if target.kind == "circles" else 1.4)
        j = np.clip(np.rint(y / size), 0, rows - 1)
        pitch, first = (size, 0.0) if target.kind == "circles" else (2.0 * size, (j % 2) * size)
        i = np.clip(np.rint((x - first) / pitch), 0, columns - 1)
        return np.where(np.hypot(x - first - pitch * i, y - size * j) < radius, _DARK, _BRIGHT)
    if target.dictionary == STANDARD_TAGS:
        return _standard_tags(target, x, y)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{target.dictionary}"))
    cells = dictionary.markerSize + 2
    found = np.full(x.shape, _BRIGHT)
    if target.kind == "charuco":
        i, j = np.floor(x / size).astype(int) + 1, np.floor(y / size).astype(int) + 1
        inside = (i >= 0) & (j >= 0) & (i < columns) & (j < rows)
        bright = inside & ((i + j) % 2 == 1)
        found = np.where(inside & ~bright, _DARK, found)
        margin = 0.5 * (size - target.part)
        a, b = (x - (i - 1) * size - margin) / target.part, (y - (j - 1) * size - margin) / target.part
        index = (j * columns + i) // 2
        marked = bright
    else:
        pitch = size + target.part
        i, j = np.floor(x / pitch).astype(int), np.floor(y / pitch).astype(int)
        a, b = (x - i * pitch) / size, (y - j * pitch) / size
        marked = (i >= 0) & (j >= 0) & (i < columns) & (j < rows)
        index = j * columns + i
        if target.upwards:
            b = 1.0 - b
        at = np.stack((x + 0.5 * target.part, y + 0.5 * target.part), axis=-1) / pitch
        joint = np.abs(at - np.rint(at)) * pitch < 0.5 * target.part  # dark squares between the tags' corners
        near = joined & np.all((np.rint(at) >= 0) & (np.rint(at) <= (columns, rows)), axis=-1)
        found = np.where(joint.all(axis=-1) & near, _DARK, found)
    u, v = np.floor(a * cells).astype(int), np.floor(b * cells).astype(int)
    marked = marked & (u >= 0) & (v >= 0) & (u < cells) & (v < cells)
    for number in np.unique(index[marked]):
        bits = dictionary.generateImageMarker(int(number), cells) > 127
        here = marked & (index == number)
        found[here] = np.where(bits[v[here], u[here]], _BRIGHT, _DARK)
    return found


def _standard_tags(target: CalibrationTarget, x: Array, y: Array) -> Array:
    """Return the brightness of tags whose border is 5 of 9 cells wide, drawn by the library of their makers."""
    pitch, cell = target.size + target.part, target.size / 5.0
    i, j = np.rint((x - 0.5 * target.size) / pitch), np.rint((y - 0.5 * target.size) / pitch)
    u, v = (np.floor((at - n * pitch) / cell).astype(int) + 2 for at, n in ((x, i), (y, j)))
    on_board = (i >= 0) & (j >= 0) & (i < target.columns) & (j < target.rows)
    marked = on_board & (u >= 0) & (v >= 0) & (u < 9) & (v < 9)
    found, index = np.full(x.shape, _BRIGHT), j * target.columns + i
    for number in np.unique(index[marked]):
        here = marked & (index == number)
        found[here] = np.where(_standard_bits(int(number))[v[here], u[here]], _BRIGHT, _DARK)
    return found


@cache
def _standard_bits(number: int) -> NDArray[np.bool_]:
    detector = pupil_apriltags.Detector(families="tagStandard41h12")
    draw = detector.libc.apriltag_to_image
    draw.restype, draw.argtypes = ctypes.POINTER(pupil_apriltags.bindings._ImageU8), [ctypes.c_void_p, ctypes.c_int]
    image = draw(ctypes.cast(detector.tag_families["tagStandard41h12"], ctypes.c_void_p), number).contents
    return np.asarray(np.ctypeslib.as_array(image.buf, (image.height, image.stride))[:9, :9] > 127)


def render(
    target: CalibrationTarget,
    camera: CameraModel,
    rotation: Array,
    translation: Array,
    sensor: Sensor,
    seed: int = 0,
    joined: bool = True,
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return the image of a target.

    Args:
        target: The target.
        camera: Intrinsics and lens; its pose counts.
        rotation: Target -> world, shape (3, 3).
        translation: Of the target's origin in the world, shape (3,) [m].
        sensor: Blur, noise, curve.
        seed: Of the noise.
        joined: Whether there are dark squares between the corners of tags.
    """
    # the inverse of the lens is smooth: a coarse grid of it, interpolated, is exact to 1e-4 px
    coarse_u, coarse_v = np.arange(-8.0, camera.width + 16.0, 8.0), np.arange(-8.0, camera.height + 16.0, 8.0)
    grid = np.stack(np.meshgrid(coarse_u, coarse_v), axis=-1)
    ideal = camera.undistort(grid.reshape(-1, 2)).reshape(grid.shape)
    lens = [RectBivariateSpline(coarse_v, coarse_u, ideal[..., k], s=0.0) for k in (0, 1)]
    turn, shift = camera.R_cam_base @ rotation, camera.R_cam_base @ translation + camera.t_cam_base
    plane = np.linalg.inv(np.column_stack((turn[:, :2], shift)))
    light = np.zeros((camera.height, camera.width))
    for i, j in np.ndindex(_RAYS, _RAYS):  # turned a little, so that edges along rows are not steps of a whole ray
        u = np.arange(camera.width) + (i + (j + 0.5) / _RAYS) / _RAYS - 0.5
        v = np.arange(camera.height) + (j + (i + 0.5) / _RAYS) / _RAYS - 0.5
        rays = np.stack((lens[0](v, u), lens[1](v, u), np.ones_like(light)), axis=-1) @ plane.T
        light += brightness(target, rays[..., :2] / rays[..., 2:], joined) / _RAYS**2
    light = np.asarray(cv2.GaussianBlur(light, (0, 0), sensor.blur), dtype=np.float64)
    rng, full = np.random.default_rng(seed), 2.0**sensor.bits - 1.0
    numbers = full * (
        np.clip(sensor.exposure * light, 0.0, 1.0) ** (1.0 / sensor.gamma) + rng.normal(0.0, sensor.noise, light.shape)
    )
    whole = np.clip(np.rint(numbers), 0.0, full)
    return whole.astype(np.uint8) if sensor.bits == 8 else whole.astype(np.uint16)
