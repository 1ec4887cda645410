"""The wrist light as seen by a camera, directly and in flat metal."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_cell.camera_model import CameraModel
from im_cell.psf import amplitude_to_flux, pixel_integrals
from im_cell.robot import Mirror

Array = NDArray[np.float64]
FloatImage = NDArray[np.float32]

REFERENCE_DISTANCE_M = 3.5
REFERENCE_AMPLITUDE_DN = 165.0
"""Peak of a light seen along its axis from the reference distance, at the nominal exposure."""
SIDEWAYS_LOSS = 0.3
"""Share of its brightness a light loses seen at a right angle to its axis."""

_REFERENCE_SIGMA_PX = 1.2
_PATCH_SIGMAS = 6.0
_AXES = {"x": 0, "y": 1, "z": 2}
_SKIN_M = 0.002


@dataclass(frozen=True)
class Spot:
    """A light in an image: centre [px], flux [DN] at the nominal exposure, standard deviation [px]."""

    uv: tuple[float, float]
    flux: float
    sigma: float


def image_of_light(
    camera: CameraModel, position: Array, axis: Array, diameter_m: float, half_angle_rad: float, blur_px: float
) -> Spot | None:
    """Project a diffuse dome, as if nothing stood in the way.

    Its flux falls with the square of the distance and, as frosted domes do, a little with the angle off its axis; its
    disc, a uniform one with standard deviation radius / 2, widens the lens's blur.

    Args:
        camera: The true camera, with its pose in the world.
        position: Centre of the light in the world, shape (3,) [m].
        axis: Direction it faces, unit vector in the world, shape (3,) [-].
        diameter_m: Its diameter [m].
        half_angle_rad: Angle off the axis beyond which no light is seen [rad].
        blur_px: Standard deviation of the lens's blur [px].

    Returns:
        The spot, None where the light faces away or is behind the camera or out of its image.
    """
    towards = camera.position - position
    distance = float(np.linalg.norm(towards))
    cosine = float(axis @ towards) / distance
    uv = camera.project(position)
    if cosine < np.cos(half_angle_rad) or not bool(camera.contains(uv, margin=-_PATCH_SIGMAS)):
        return None
    disc = 0.25 * diameter_m * float(np.sqrt(camera.K[0, 0] * camera.K[1, 1])) / distance
    flux = amplitude_to_flux(REFERENCE_AMPLITUDE_DN, _REFERENCE_SIGMA_PX) * (REFERENCE_DISTANCE_M / distance) ** 2
    brightness = 1.0 - SIDEWAYS_LOSS * (1.0 - cosine)
    return Spot((float(uv[0]), float(uv[1])), brightness * flux, float(np.hypot(blur_px, disc)))


def add_spot(image: FloatImage, spot: Spot, strength: float) -> None:
    """Add a spot to an image, shape (h, w) [DN], in place.

    Args:
        image: The image.
        spot: The spot.
        strength: Exposure in units of the nominal one, times the fraction of it during which the light was on [-].
    """
    reach = int(np.ceil(_PATCH_SIGMAS * spot.sigma))
    column, row = round(spot.uv[0]), round(spot.uv[1])
    columns = np.arange(max(column - reach, 0), min(column + reach + 1, image.shape[1]), dtype=float)
    rows = np.arange(max(row - reach, 0), min(row + reach + 1, image.shape[0]), dtype=float)
    if not (len(columns) and len(rows)):
        return
    along_u = pixel_integrals(spot.uv[0], spot.sigma, columns)
    along_v = pixel_integrals(spot.uv[1], spot.sigma, rows)
    area = np.s_[int(rows[0]) : int(rows[-1]) + 1, int(columns[0]) : int(columns[-1]) + 1]
    image[area] += strength * spot.flux * np.outer(along_v, along_u)


@dataclass(frozen=True)
class Reflection:
    """Light seen in a mirror: the virtual position [m] and axis, and the place of reflection [m]."""

    position: Array
    axis: Array
    bounce: Array


def reflect(
    mirror: Mirror, rotation: Array, origin: Array, position: Array, axis: Array, eye: Array
) -> Reflection | None:
    """The image of a light in a mirror.

    Args:
        mirror: The mirror.
        rotation: Rotation of its link -> world, shape (3, 3).
        origin: Origin of its link in the world, shape (3,) [m].
        position: The light in the world, shape (3,) [m].
        axis: Direction the light faces, shape (3,).
        eye: Optical centre of the camera, shape (3,) [m].

    Returns:
        The reflection, None where the mirror throws nothing from the light to the camera.
    """
    across = _AXES[mirror.axis]
    normal, centre = rotation[:, across], origin + rotation @ np.array(mirror.center)
    height, eye_height = normal @ (position - centre), normal @ (eye - centre)
    if height <= _SKIN_M or eye_height <= _SKIN_M:
        return None
    bounce = position + (eye - position) * height / (height + eye_height)
    bounce = bounce - normal * (normal @ (bounce - centre))
    within = np.delete(rotation.T @ (bounce - centre), across)
    if np.any(np.abs(within) > 0.5 * np.array(mirror.size)):
        return None
    return Reflection(
        position - 2.0 * height * normal, axis - 2.0 * (normal @ axis) * normal, bounce + _SKIN_M * normal
    )
