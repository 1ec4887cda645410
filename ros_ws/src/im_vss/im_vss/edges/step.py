"""Maximum-likelihood fit of a blurred step of brightness along a curve, and along a straight edge."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from im_cell.camera_model import POSE_PARAMETERS, CameraModel
from im_cell.sensor import SensorNoise

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Distance = Callable[[Array], Array]

_ITERATIONS = 30
_BLUR_PX = 1.0
"""Guess of the blur that a fit begins with [px]."""
_TOLERANCE_PX = 1e-4
_SIGMA_PX = (0.3, 4.0)
_STEP_PX = 1e-4
_MOST_PX = 1.0
_SQRT2PI = float(np.sqrt(2.0 * np.pi))


@dataclass(frozen=True)
class StepFit:
    """A step of brightness along a curve.

    Attributes:
        shape: Parameters of the curve, shape (n,).
        covariance: Their covariance, widened where the misfit is more than noise, shape (n, n).
        contrast: Brightness on the side of positive distances less that on the other [DN].
        sigma: Standard deviation of the blur, the pixel's own width included [px].
        chi2_per_dof: Mean squared normalised residual [-].
        contrast_snr: Contrast over its standard deviation [-].
    """

    shape: Array
    covariance: Array
    contrast: float
    sigma: float
    chi2_per_dof: float
    contrast_snr: float


def fit_step(values: Array, distance: Distance, start: Array, noise: SensorNoise) -> StepFit | None:
    """Fit a curve between two brightnesses, seen through a Gaussian blur, to the pixels around the curve.

    Gauss-Newton on (shape, lower brightness, contrast, blur), each pixel weighted by the variance that the noise model
    predicts for the fitted brightness.

    Args:
        values: Pixels, shape (m,) [DN].
        distance: Signed distance of each pixel from the curve of some parameters, shape (m,) [px].
        start: Parameters near the solution, shape (n,).
        noise: Noise of the sensor.

    Returns:
        The fit, None where the pixels support none.
    """
    usable = values < noise.saturation
    if usable.sum() <= len(start) + 3:
        return None
    values = values[usable]
    side = distance(start)[usable] > 0.0
    if side.all() or not side.any():
        return None
    low = float(np.median(values[~side]))
    theta = np.concatenate((start, [low, float(np.median(values[side])) - low, _BLUR_PX]))
    for _ in range(_ITERATIONS):
        mean, jacobian = _model(theta, distance, usable)
        weight = 1.0 / noise.variance(np.maximum(mean, 0.0))
        try:
            step = np.linalg.solve((jacobian.T * weight) @ jacobian, jacobian.T @ (weight * (values - mean)))
        except np.linalg.LinAlgError:
            return None
        largest = float(np.abs(step[:-3]).max())
        theta = theta + step * min(1.0, _MOST_PX / max(largest, 1e-12))
        theta[-1] = np.clip(theta[-1], *_SIGMA_PX)
        if not np.all(np.isfinite(theta)):
            return None
        if largest < _TOLERANCE_PX:
            return _result(theta, values, distance, usable, noise)
    return None


def _model(theta: Array, distance: Distance, usable: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return expected pixels, shape (m,), and the Jacobian, shape (m, n + 3)."""
    shape, (low, contrast, sigma) = theta[:-3], theta[-3:]
    away = distance(shape)[usable]
    ramp = scipy.special.ndtr(away / sigma)
    slope = contrast * np.exp(-0.5 * (away / sigma) ** 2) / (_SQRT2PI * sigma)
    jacobian = np.empty((len(away), len(theta)))
    for column in range(len(shape)):
        moved = shape.copy()
        moved[column] += _STEP_PX
        jacobian[:, column] = slope * (distance(moved)[usable] - away) / _STEP_PX
    jacobian[:, -3] = 1.0
    jacobian[:, -2] = ramp
    jacobian[:, -1] = -slope * away / sigma
    return low + contrast * ramp, jacobian


def _result(
    theta: Array, values: Array, distance: Distance, usable: NDArray[np.bool_], noise: SensorNoise
) -> StepFit | None:
    mean, jacobian = _model(theta, distance, usable)
    weight = 1.0 / noise.variance(np.maximum(mean, 0.0))
    try:
        covariance = np.linalg.inv((jacobian.T * weight) @ jacobian)
    except np.linalg.LinAlgError:
        return None
    if np.any(np.diag(covariance) <= 0.0):
        return None
    chi2 = float((weight * (values - mean) ** 2).sum()) / (len(values) - len(theta))
    return StepFit(
        shape=theta[:-3],
        covariance=np.asarray(covariance[:-3, :-3] * max(1.0, chi2), dtype=float),
        contrast=float(theta[-2]),
        sigma=float(theta[-1]),
        chi2_per_dof=chi2,
        contrast_snr=abs(float(theta[-2])) / float(np.sqrt(covariance[-2, -2])),
    )


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


def undistorted_by_parameters(camera: CameraModel, undistorted_pixels: Array) -> Array:
    """Return the errors of undistorted pixels by errors of the camera; the pose of the camera has no part.

    What is seen stays where it is in the image: the undistorted pixel of its direction changes, and where in the image
    that direction is seen.

    Args:
        camera: Intrinsics and lens.
        undistorted_pixels: Where, shape (n, 2) [px].

    Returns:
        Derivatives by :data:`im_cell.camera_model.PARAMETERS`, shape (n, 2, 18) [px by the unit of each].
    """
    pinhole = camera.K[:2, :2]
    inverse = np.linalg.inv(pinhole)
    ideal = (undistorted_pixels - camera.K[:2, 2]) @ inverse.T
    here = replace(camera, R_cam_base=np.eye(3), t_cam_base=np.zeros(3))
    seen = here.project_by_parameters(np.column_stack((ideal, np.ones(len(ideal)))))
    seen[..., -POSE_PARAMETERS:] = 0.0
    return np.asarray(-np.linalg.solve(pinhole @ camera.lens.jacobian(ideal, camera.D) @ inverse, seen))


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
