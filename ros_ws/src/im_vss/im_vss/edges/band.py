"""The pixels along a straight piece of an image, and straight edges through them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_core.camera_model import CameraModel
from im_vss.edges.step import StepFit, fit_step
from im_vss.spot import SensorNoise

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class StraightEdge:
    """A straight edge in undistorted pixels.

    Attributes:
        middle: A point on it, halfway, shape (2,) [px].
        direction: Unit vector along it, shape (2,); the brighter side is to the right (image rows grow downwards).
        length: How far it was followed [px].
        fit: Parameters (offset along the normal at the middle [px], angle [rad]), zero at the edge itself.
        points: Pixels that were used.
    """

    middle: Array
    direction: Array
    length: float
    fit: StepFit
    points: int

    @property
    def normal(self) -> Array:
        """Unit vector to the right of :attr:`direction`, shape (2,)."""
        return np.array([-self.direction[1], self.direction[0]])


def undistorted(camera: CameraModel, pixels: Array) -> Array:
    """Where pixels, shape (..., 2) [px], would be if the lens did not distort, shape (..., 2) [px].

    Raises:
        DataError: The lens model cannot be inverted there.
    """
    return camera.to_pixels(camera.undistort(pixels))


def follow_edge(
    image: Image, camera: CameraModel, ends: Array, half: float, margin: float, noise: SensorNoise
) -> StraightEdge | None:
    """Fit a straight edge near a piece of the image.

    Args:
        image: Pixels, shape (h, w) [DN].
        camera: Intrinsics and lens.
        ends: Two points of the image between which the edge runs, shape (2, 2) [px].
        half: How far to both sides pixels are used [px].
        margin: How far from the ends they are left out [px].
        noise: Noise of the sensor.

    Returns:
        The edge, None where there is none.

    Raises:
        DataError: The lens model cannot be inverted there.
    """
    low = np.maximum(np.floor(ends.min(axis=0) - half - 1), 0).astype(int)
    high = np.minimum(np.ceil(ends.max(axis=0) + half + 2), [image.shape[1], image.shape[0]]).astype(int)
    if np.any(high - low < 2):
        return None
    columns, rows = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    pixels = np.stack((columns.ravel(), rows.ravel()), axis=-1)
    rough = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    across = (pixels - ends[0]) @ np.array([-rough[1], rough[0]])
    pixels = pixels[np.abs(across) <= half + 2.0]
    start, end = undistorted(camera, ends)
    places = undistorted(camera, pixels.astype(float))
    middle, length = (start + end) / 2.0, float(np.linalg.norm(end - start))
    direction = (end - start) / length
    normal = np.array([-direction[1], direction[0]])
    x, y = (places - middle) @ direction, (places - middle) @ normal
    chosen = (np.abs(x) <= length / 2.0 - margin) & (np.abs(y) <= half)
    x, y, values = x[chosen], y[chosen], image[pixels[chosen, 1], pixels[chosen, 0]].astype(float)
    if len(values) < 12:
        return None
    lever = length / 2.0  # the angle is fitted as the shift of an end, so that all parameters are of one size [px]

    def distance(shape: Array) -> Array:
        angle = shape[1] / lever
        return np.asarray(np.cos(angle) * y - np.sin(angle) * x - shape[0])

    fit = fit_step(values, distance, np.zeros(2), noise)
    if fit is None or np.abs(fit.shape).max() > half:
        return None
    offset, angle = float(fit.shape[0]), float(fit.shape[1]) / lever
    turned = np.cos(angle) * direction + np.sin(angle) * normal
    foot = middle + offset * np.array([-turned[1], turned[0]])
    scale = np.array([1.0, 1.0 / lever])
    if fit.contrast < 0.0:
        turned, scale = -turned, scale * np.array([-1.0, 1.0])
    unit = StepFit(
        np.zeros(2), np.outer(scale, scale) * fit.covariance, abs(fit.contrast), fit.sigma, fit.chi2_per_dof,
        fit.contrast_snr,
    )  # fmt: skip
    return StraightEdge(foot, turned, length, unit, len(values))
