"""The laser as seen by a camera: the end of the beam in the scene, and the brightness."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from im_cell.camera_model import CameraModel
from im_cell.laser_model import LaserModel
from im_cell.link import Exposure, LaserBeam
from im_cell.psf import amplitude_to_flux
from im_cell.robot import Box, Cell
from im_sim.cameras.lens import FloatImage
from im_sim.cameras.light import REFERENCE_AMPLITUDE_DN, REFERENCE_DISTANCE_M, Spot, add_spot
from im_sim.cameras.plates import Plates
from im_sim.cameras.scene import SceneMirror

Array = NDArray[np.float64]

_REACH_M = 9.0
_SKIN_M = 0.003
_FLUX_DN = amplitude_to_flux(REFERENCE_AMPLITUDE_DN, 1.2)
_LINE_STEP_RAD = 0.0003
_LUMA = np.array([0.299, 0.587, 0.114])
_SPECKLE_REACH_SIGMAS = 6.0


@dataclass(frozen=True)
class _Box:
    """Box of the cell: the frame, the middle there and half the edges [m], the brightness."""

    link: str
    center: Array
    half: Array
    albedo: float


class LaserLight:
    """Draws the beam of one testbed's laser scanner.

    Robot and carts are met as they collide, boxes and printed plates as they are drawn.
    """

    def __init__(self, cell: Cell, true: LaserModel, scene: SceneMirror, seed: int) -> None:
        """Set up.

        Args:
            cell: Data sheet of the scanner, boxes, plates and colours.
            true: What the scanner is really like.
            scene: Mirror of the testbed.
            seed: Seed of the speckle.
        """
        self._scanner, self._true, self._scene, self._seed = cell.scanner, true, scene, seed
        self._blur = cell.optics.blur
        self._boxes = [_box(box) for box in cell.boxes]
        self._plates = Plates(cell.targets, scene.pose)
        self._arm_albedo = float(np.mean([_LUMA @ group.color for group in cell.groups.values()]))

    def add(self, image: FloatImage, camera: str, placed: CameraModel, exposure: Exposure) -> None:
        """Add spot or line to an image in place.

        Args:
            image: Expected values at the nominal exposure, shape (h, w) [DN].
            camera: Name of the camera.
            placed: The camera, with its pose in the world.
            exposure: What the shutter saw; the scene is at its joint positions.
        """
        beam = exposure.laser
        if beam.power <= 0.0:
            return
        angles = _angles(beam)
        points, normals, albedo = self.ends(angles)
        pixels, flux = self._seen(placed, points, normals, albedo)
        keep = flux > 0.0
        if not keep.any():
            return
        sigma = self._sigma(placed, points[keep])
        area = _area(pixels[keep], sigma, image.shape)
        corner = np.array([area[1].start, area[0].start])
        speckle = np.random.Generator(
            np.random.Philox(np.random.SeedSequence([self._seed & 0xFFFFFFFFFFFFFFFF, *camera.encode(), *_key(beam)]))
        )
        lit = np.zeros_like(image[area])
        share = beam.power * self._scanner.brightness / len(angles)
        if len(angles) == 1:
            u, v = pixels[0] - corner
            add_spot(lit, Spot((float(u), float(v)), share * float(flux[0]), sigma), 1.0)
        else:
            _splat(lit, pixels[keep] - corner, share * flux[keep], sigma)
        lit *= 1.0 + self._scanner.speckle * speckle.standard_normal(lit.shape, dtype=np.float32)
        image[area] += lit

    def ends(self, angles: Array) -> tuple[Array, Array, Array]:
        """Where beams end.

        Args:
            angles: True angles of the mirrors as they would report them, shape (n, 2) [rad].

        Returns:
            Points, shape (n, 3) [m], NaN where a beam meets nothing; outward normals, shape (n, 3); albedo, shape (n,).
        """
        starts, directions = self._true.rays(angles)
        share, normals, albedo = self._first(starts, starts + _REACH_M * directions)
        points = starts + (share * _REACH_M)[:, None] * directions
        points[share >= 1.0] = np.nan
        return points, normals, albedo

    def _first(self, starts: Array, ends: Array) -> tuple[Array, Array, Array]:
        """Return the free share of each way, shape (n,), normals, shape (n, 3), and albedo at the end, shape (n,)."""
        share, normals = self._scene.first_hits(starts, ends)
        albedo = np.full(len(starts), self._arm_albedo)
        for box in self._boxes:
            rotation, origin = self._scene.pose(box.link)
            entry, normal = _enter(box, (starts - origin) @ rotation, (ends - origin) @ rotation)
            nearer = entry < share
            share[nearer], albedo[nearer] = entry[nearer], box.albedo
            normals[nearer] = normal[nearer] @ rotation.T
        pierced, sides, printed = self._plates.first(starts, ends)
        nearer = pierced < share
        share[nearer], normals[nearer], albedo[nearer] = pierced[nearer], sides[nearer], printed[nearer]
        return share, normals, albedo

    def _seen(self, placed: CameraModel, points: Array, normals: Array, albedo: Array) -> tuple[Array, Array]:
        """Pixels, shape (n, 2) [px], and flux of diffuse points at full power [DN], 0 where a camera sees nothing."""
        towards = placed.position - points
        distance = np.linalg.norm(towards, axis=1)
        cosine = np.einsum("ni,ni->n", towards, normals) / distance
        pixels = placed.project(points)
        with np.errstate(invalid="ignore"):
            seen = (cosine > 0.0) & placed.contains(pixels, margin=-_SPECKLE_REACH_SIGMAS)
        flux = np.zeros(len(points))
        if seen.any():
            skin = points[seen] + _SKIN_M * normals[seen]
            free = self._first(skin, np.broadcast_to(placed.position, skin.shape))[0] >= 1.0
            flux[seen] = free * albedo[seen] * cosine[seen] * (REFERENCE_DISTANCE_M / distance[seen]) ** 2 * _FLUX_DN
        return pixels, flux

    def _sigma(self, placed: CameraModel, points: Array) -> float:
        """Return the width of the beam's image [px]: lens and disc; standard deviation of the disc: radius / 2."""
        distance = float(np.median(np.linalg.norm(points - placed.position, axis=1)))
        return float(np.hypot(self._blur, 0.25 * self._scanner.diameter * placed.K[0, 0] / distance))


def _angles(beam: LaserBeam) -> Array:
    """Return the mirror angles of the beam during an exposure, shape (n, 2) [rad]: a linear sweep."""
    if beam.half_sweep <= 0.0:
        return np.array([[beam.mirror1, beam.mirror2]])
    count = int(np.ceil(2.0 * beam.half_sweep / _LINE_STEP_RAD)) + 1
    first = np.linspace(-beam.half_sweep, beam.half_sweep, count) + beam.mirror1
    return np.stack((first, np.full(count, beam.mirror2)), axis=1)


def _key(beam: LaserBeam) -> list[int]:
    """Return numbers which differ for beams of different speckle."""
    return [round(abs(value) * 1e7) for value in beam.values()[:3]]


def _box(box: Box) -> _Box:
    return _Box(box.link, np.array(box.center), 0.5 * np.array(box.size), float(_LUMA @ box.color))


def _enter(box: _Box, starts: Array, ends: Array) -> tuple[Array, Array]:
    """Return the share of each way, shape (n, 3) each end, up to a box, 2 without an entry; and normals there.

    Source: T. Kay, J. Kajiya, "Ray tracing complex scenes", SIGGRAPH 1986 (slabs).
    """
    way = ends - starts
    with np.errstate(divide="ignore", invalid="ignore"):
        low = (box.center - box.half - starts) / way
        high = (box.center + box.half - starts) / way
    near, far = np.fmin(low, high), np.fmax(low, high)
    axis = np.argmax(near, axis=1)
    entry, leave = near.max(axis=1), far.min(axis=1)
    entry = np.where((entry <= leave) & (entry >= 0.0), entry, 2.0)
    normals = np.zeros_like(way)
    rows = np.arange(len(way))
    normals[rows, axis] = -np.sign(way[rows, axis])
    return entry, normals


def _area(pixels: Array, sigma: float, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the part of an image of a shape within a width [px] of points, shape (n, 2) [px]."""
    reach = _SPECKLE_REACH_SIGMAS * sigma + 2.0
    low = np.clip(np.floor(pixels.min(axis=0) - reach), 0, None).astype(int)
    high = np.ceil(pixels.max(axis=0) + reach).astype(int) + 1
    return slice(low[1], max(low[1], min(high[1], shape[0]))), slice(low[0], max(low[0], min(high[0], shape[1])))


def _splat(image: FloatImage, pixels: Array, flux: Array, sigma: float) -> None:
    """Add points with flux, shape (n, 2) [px] and (n,) [DN], as Gaussians of one width [px].

    Each point is shared among the four pixels around it, which keeps the centre, and adds at most 1/4 px^2 of variance
    to each axis, on average 1/6: that is taken off the blur's.
    """
    sharp = np.zeros_like(image)
    corner = np.floor(pixels).astype(int)
    fraction = pixels - corner
    for dv in (0, 1):
        for du in (0, 1):
            column, row = corner[:, 0] + du, corner[:, 1] + dv
            weight = np.abs(1 - du - fraction[:, 0]) * np.abs(1 - dv - fraction[:, 1])
            inside = (column >= 0) & (column < image.shape[1]) & (row >= 0) & (row < image.shape[0])
            np.add.at(sharp, (row[inside], column[inside]), (weight * flux)[inside].astype(np.float32))
    blur = float(np.sqrt(max(sigma**2 - 1.0 / 6.0, 0.1)))
    image += cv2.GaussianBlur(sharp, (0, 0), blur, borderType=cv2.BORDER_CONSTANT)
