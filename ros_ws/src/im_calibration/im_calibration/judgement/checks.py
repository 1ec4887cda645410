"""Checks of a calibration on the same data: poses predicted from the others, and a half of the space from the other."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.chi_squared import chi2_beyond
from im_calibration.estimation.gates import Gated, predict_from_others
from im_calibration.estimation.unknowns import ParameterLayout
from im_calibration.problem.problem import CalibrationProblem
from im_cell.calibration_error import rms

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Checks:
    """Evidence of the data on the estimate; each found value stands beside the expected one, NaN where undefined.

    Attributes:
        held_out_px: RMS distance of a used spot from where the other poses predict it [px].
        held_out_expected_px: The same by the stated noise and the covariance of the estimate [px].
        far_half_px: RMS distance of a used spot from where the poses of the other half of the space predict it, the
            space cut across its longest, middle or shortest extent, whatever is least likely [px].
        far_half_expected_px: The same by noise and covariance [px].
        far_half_p_value: Probability of a distance this large or larger in one of the six halves.
    """

    held_out_px: float
    held_out_expected_px: float
    far_half_px: float
    far_half_expected_px: float
    far_half_p_value: float


def check(gated: Gated, problem: CalibrationProblem, layout: ParameterLayout) -> Checks:
    """Check an estimate."""
    prediction = predict_from_others(gated.fit, problem, layout, gated.used)
    rows = np.repeat(gated.used.T, 2, axis=1)
    variances = np.diagonal(prediction.covariances, axis1=1, axis2=2)[rows]
    held_out, expected = np.sqrt(2.0) * rms(prediction.errors[rows]), np.sqrt(2.0) * rms(np.sqrt(variances))
    used = gated.used.any(axis=0)
    away = problem.positions - np.median(problem.positions[used], axis=0)
    alone = problem.placements is not None and problem.placements.held is not None
    if alone:  # no half of the views knows anything of where the target is in the other
        return Checks(float(held_out), float(expected), np.nan, np.nan, np.nan)
    halves = [side for axis in np.linalg.svd(away[used])[2] for side in (away @ axis > 0.0, away @ axis <= 0.0)]
    found = [_half(gated, problem, side) for side in halves]
    chance, far, far_expected = min(found, key=lambda half: half[0] if np.isfinite(half[0]) else np.inf)
    return Checks(float(held_out), float(expected), far, far_expected, min(1.0, len(halves) * chance))


def _half(gated: Gated, problem: CalibrationProblem, predicted: Mask) -> tuple[float, float, float]:
    """Predict the spots of some poses from the spots of the others.

    The sum of squared errors with covariance C is taken for chi-square with ``tr(C)^2 / tr(C^2)`` degrees of freedom.
    Source: Satterthwaite, "An approximate distribution of estimates of variance components" (1946).

    Args:
        gated: The estimate from all poses.
        problem: What it was made from.
        predicted: The poses to predict, shape (n,).

    Returns:
        Probability of errors this large or larger, their RMS length, and that to expect [px]; NaN with too few spots.
    """
    if np.any(gated.used[:, predicted].sum(axis=1) < 1) or np.any(
        gated.used[:, ~predicted].sum(axis=1) < problem.fewest_spots
    ):
        return np.nan, np.nan, np.nan
    line, rows = gated.fit.linearisation, np.repeat(gated.used[:, predicted].T, 2, axis=1)
    jacobians, spread, residuals = (a[predicted] for a in (line.jacobians, line.covariances, line.residuals))
    flat = jacobians.reshape(-1, jacobians.shape[2])
    weighted = (np.linalg.inv(spread) @ jacobians).reshape(flat.shape).T
    without = gated.fit.information - weighted @ flat
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gated.fit.information), 1e-300))
    covariance = np.linalg.inv(without * scale[:, None] * scale + 1e-12 * np.eye(len(scale))) * scale[:, None] * scale
    errors = residuals + jacobians @ (covariance @ (weighted @ residuals.ravel()))
    noise = np.where(rows[:, :, None] & rows[:, None, :], spread, 0.0)
    by_cameras = covariance @ (flat.T @ flat)
    common = flat.T @ (noise @ jacobians).reshape(flat.shape)
    first = float(np.trace(noise, axis1=1, axis2=2).sum() + np.trace(by_cameras))
    second = float((noise**2).sum() + 2.0 * (covariance * common).sum() + (by_cameras * by_cameras.T).sum())
    squared, spots = float((errors[rows] ** 2).sum()), float(rows.sum()) / 2.0
    chance = float(chi2_beyond(squared * first / second, first**2 / second))
    return chance, float(np.sqrt(squared / spots)), float(np.sqrt(first / spots))
