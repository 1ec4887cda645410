"""The wrist light as a camera sees it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_core.camera_model import CameraModel
from im_vss.spot.psf import amplitude_to_flux, pixel_integrals

Array = NDArray[np.float64]
FloatImage = NDArray[np.float32]

REFERENCE_DISTANCE_M = 3.5
REFERENCE_AMPLITUDE_DN = 165.0
"""Peak of a light seen along its axis from the reference distance, at the nominal exposure."""
SIDEWAYS_LOSS = 0.3
"""Share of its brightness a light loses seen at a right angle to its axis."""
_REFERENCE_SIGMA_PX = 1.2
_PATCH_SIGMAS = 6.0


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
