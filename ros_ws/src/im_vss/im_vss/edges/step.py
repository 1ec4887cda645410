"""Maximum-likelihood fit of a blurred step of brightness along a curve with a few parameters."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from im_vss.spot import SensorNoise

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Distance = Callable[[Array], Array]

_ITERATIONS = 30
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


def fit_step(values: Array, distance: Distance, start: Array, noise: SensorNoise, sigma: float = 1.0) -> StepFit | None:
    """Fit a curve that separates two brightnesses, seen through a Gaussian blur, to the pixels around it.

    Gauss-Newton on (shape, lower brightness, contrast, blur), each pixel weighted by the variance that the noise model
    predicts for the fitted brightness.

    Args:
        values: Pixels, shape (m,) [DN].
        distance: Signed distance of each pixel from the curve of some parameters, shape (m,) [px].
        start: Parameters near the solution, shape (n,).
        noise: Noise of the sensor.
        sigma: Guess of the blur [px].

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
    theta = np.concatenate((start, [low, float(np.median(values[side])) - low, sigma]))
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
    """Expected pixels, shape (m,), and their Jacobian, shape (m, n + 3)."""
    shape, (low, contrast, sigma) = theta[:-3], theta[-3:]
    away = distance(shape)[usable]
    ramp = ndtr(away / sigma)
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
