"""Printed plates as seen by a camera, drawn by rays through the true lens, and as obstacles of light and laser."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from im_cell.camera_model import CameraModel
from im_cell.fiducial import CELLS, code_of
from im_cell.robot import Target

Array = NDArray[np.float64]
FloatImage = NDArray[np.float32]

WHITE, BLACK = 0.9, 0.06
"""Brightness of paper and ink, relative to a white surface."""

_MOST_SAMPLES = 2_000_000
_FINEST = 8
_BEHIND_M = 0.02
_NEAREST_M = 0.05
_BLUR_REACH = 4.0
_MISSED = 2.0


@dataclass(frozen=True)
class TargetPatch:
    """A target in an image, sharp: the part of the image, coverage and brightness there, and depths [m]."""

    area: tuple[slice, slice]
    coverage: FloatImage
    brightness: FloatImage
    depth: FloatImage

    def paint(self, scene: FloatImage, depth: FloatImage, blur: float) -> None:
        """Paint the target into a scene, behind the objects in front of the target.

        Args:
            scene: Brightness, 0 to 1, shape (h, w); changed in place.
            depth: Depth of what the scene shows, shape (h, w) [m].
            blur: Standard deviation of the lens's blur [px].
        """
        seen = (depth[self.area] > self.depth - _BEHIND_M).astype(np.float32)
        covered = cv2.GaussianBlur(self.coverage * seen, (0, 0), blur, borderType=cv2.BORDER_REPLICATE)
        bright = cv2.GaussianBlur(self.brightness * seen, (0, 0), blur, borderType=cv2.BORDER_REPLICATE)
        scene[self.area] = scene[self.area] * (1.0 - covered) + bright


Place = Callable[[str], tuple[Array, Array]]
"""Returns where a frame is in the world: rotation, shape (3, 3), and origin, shape (3,) [m]."""


def in_world(target: Target, place: Place) -> tuple[Array, Array]:
    """Return rotation and position of a target in the world, with the frame that it is fixed to."""
    rotation, position = target.pose()
    frame, origin = place(target.parent)
    return frame @ rotation, frame @ position + origin


def target_patch(
    target: Target, pose: tuple[Array, Array], camera: CameraModel, ideal: Array, blur: float
) -> TargetPatch | None:
    """Draw a target, as if nothing stood in the way.

    Args:
        target: The target.
        pose: Where it is in the world, as of :func:`in_world`.
        camera: The true camera, with its pose in the world.
        ideal: For each pixel the ideal image point of its centre, shape (h, w, 2) [-].
        blur: Standard deviation of the lens's blur [px], for which room is left.

    Returns:
        The target, None where it is out of view or faces away.
    """
    rotation, position = pose
    R, t = camera.R_cam_base @ rotation, camera.to_camera(position)
    if t @ R[:, 2] >= 0.0:
        return None
    area = _area(target, camera, rotation, position, blur)
    if area is None:
        return None
    steps = _samples(area)
    coverage, brightness, depth = (np.zeros(ideal[area].shape[:2]) for _ in range(3))
    along_v, along_u = np.gradient(ideal[area], axis=(0, 1))
    offset = float(R[:, 2] @ t)
    for dv in steps:
        for du in steps:
            points = ideal[area] + du * along_u + dv * along_v
            rays = np.concatenate((points, np.ones((*points.shape[:2], 1))), axis=-1)
            distance = offset / (rays @ R[:, 2])
            x, y = np.moveaxis((rays * distance[..., None] - t) @ R[:, :2], -1, 0)
            inside = (np.abs(x) <= target.plate / 2) & (np.abs(y) <= target.plate / 2) & (distance > 0.0)
            coverage += inside
            brightness += inside * np.where(ink(target, x, y), BLACK, WHITE)
            depth += distance
    share = len(steps) ** 2
    return TargetPatch(area, *((image / share).astype(np.float32) for image in (coverage, brightness, depth)))


def _area(
    target: Target, camera: CameraModel, rotation: Array, position: Array, blur: float
) -> tuple[slice, slice] | None:
    """Return the part of the image near the target."""
    turn = np.linspace(-0.5, 0.5, 9)
    rim = [(s, e) for s in turn for e in (-0.5, 0.5)] + [(e, s) for s in turn for e in (-0.5, 0.5)]
    world = position + target.plate * np.array(rim) @ rotation[:, :2].T
    if np.any(camera.to_camera(world)[:, 2] < _NEAREST_M):
        return None
    pixels = camera.project(world)
    margin = _BLUR_REACH * blur + 1.0
    low = np.maximum(np.floor(pixels.min(axis=0) - margin), 0).astype(int)
    high = np.minimum(np.ceil(pixels.max(axis=0) + margin) + 1, [camera.width, camera.height]).astype(int)
    if np.any(high - low < 3):
        return None
    return slice(low[1], high[1]), slice(low[0], high[0])


def _samples(area: tuple[slice, slice]) -> Array:
    """Return the places of the samples within a pixel, one row of a square grid [px]; fewer for a large target."""
    pixels = (area[0].stop - area[0].start) * (area[1].stop - area[1].start)
    count = int(np.clip(np.sqrt(_MOST_SAMPLES / pixels), 2, _FINEST))
    return np.asarray((np.arange(count) + 0.5) / count - 0.5)


def ink(target: Target, x: Array, y: Array) -> NDArray[np.bool_]:
    """Whether the print is black at places of the plate, of any shape [m]."""
    half = target.size / 2.0
    if target.kind == "circle":
        return np.asarray(np.hypot(x, y) <= half)
    if target.kind == "chessboard":  # the upper left square is black
        (columns, rows), right, down = target.corners, x / target.size, -y / target.size
        square = np.floor(right + (columns + 1) / 2.0) + np.floor(down + (rows + 1) / 2.0)
        printed = (np.abs(right) < (columns + 1) / 2.0) & (np.abs(down) < (rows + 1) / 2.0)
        return np.asarray(printed & (square % 2 == 0))
    inside = (np.abs(x) < half) & (np.abs(y) < half)
    if target.kind == "edge":
        return np.asarray(inside & (x > 0.0))
    column = np.clip((x + half) / target.size * CELLS, 0, CELLS - 1).astype(int)
    row = np.clip((half - y) / target.size * CELLS, 0, CELLS - 1).astype(int)
    return np.asarray(inside & ~code_of(target.id)[row, column])


@dataclass(frozen=True)
class _Plate:
    """Plate and the pose: rotation to the world, shape (3, 3), and the middle there [m]."""

    target: Target
    rotation: Array
    position: Array


class Plates:
    """All plates of a cell, infinitely thin, opaque from both sides, with white backs."""

    def __init__(self, targets: Sequence[Target], place: Place) -> None:
        self._standing = [_Plate(each, *each.pose()) for each in targets if each.parent == "world"]
        self._carried = [each for each in targets if each.parent != "world"]
        self._place = place

    def first(self, starts: Array, ends: Array) -> tuple[Array, Array, Array]:
        """Where rays first meet a plate.

        Args:
            starts: Shape (n, 3) [m].
            ends: Shape (n, 3) [m].

        Returns:
            Share of each way up to there, shape (n,), 2 where none is met; normals towards the start, shape (n, 3); and
            albedo, shape (n,).
        """
        share, normals = np.full(len(starts), _MISSED), np.zeros((len(starts), 3))
        albedo = np.zeros(len(starts))
        carried = [_Plate(each, *in_world(each, self._place)) for each in self._carried]
        for plate in (*self._standing, *carried):
            pierced, x, y, side = _pierce(plate, starts, ends)
            nearer = pierced < share
            share[nearer], normals[nearer] = pierced[nearer], side[nearer, None] * plate.rotation[:, 2]
            printed = ink(plate.target, x[nearer], y[nearer]) & (side[nearer] > 0.0)
            albedo[nearer] = np.where(printed, BLACK, WHITE)
        return share, normals, albedo

    def clear(self, start: Array, end: Array) -> bool:
        """Whether no plate stands between two points of the world, shape (3,) [m]."""
        return bool(self.first(start[None], end[None])[0][0] > 1.0)


def _pierce(plate: _Plate, starts: Array, ends: Array) -> tuple[Array, Array, Array, Array]:
    """Compute the share of each way, ends (n, 3), up to a plate, 2 for a miss; the place on the plate [m]; the side."""
    start, end = (starts - plate.position) @ plate.rotation, (ends - plate.position) @ plate.rotation
    half = 0.5 * plate.target.plate
    with np.errstate(divide="ignore", invalid="ignore"):
        share = start[:, 2] / (start[:, 2] - end[:, 2])
        x, y, _ = (start + share[:, None] * (end - start)).T
        met = (share >= 0.0) & (share <= 1.0) & (np.abs(x) <= half) & (np.abs(y) <= half)
    return np.where(met, share, _MISSED), x, y, np.sign(start[:, 2])
