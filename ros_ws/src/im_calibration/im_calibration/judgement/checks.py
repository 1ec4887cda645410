"""Checks of a calibration on the same data: poses predicted from the others, and two halves against each other."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.covariance import covariance_of
from im_calibration.estimation.gates import Gated, predict_from_others
from im_calibration.estimation.projection import image
from im_calibration.estimation.solve import maximise_likelihood
from im_calibration.estimation.unknowns import ParameterLayout
from im_calibration.judgement.expected import expected_error, inside
from im_calibration.problem.problem import CalibrationProblem
from im_cell.calibration_error import rms

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Checks:
    """Evidence of the data on the estimate; each found value stands beside the expected one, NaN where undefined.

    Attributes:
        held_out_px: RMS distance of a used spot from where the other poses predict it [px].
        held_out_expected_px: The same by the stated noise and the covariance of the estimate [px].
        split_half_px: RMS distance between the images of the workspace by two calibrations from half of the poses
            each [px].
        split_half_expected_px: The same by the covariances of the two [px].
    """

    held_out_px: float
    held_out_expected_px: float
    split_half_px: float
    split_half_expected_px: float


def check(gated: Gated, problem: CalibrationProblem, layout: ParameterLayout) -> Checks:
    """Check an estimate.

    Args:
        gated: The estimate.
        problem: What it was made from, in canonical order: every other pose makes a half that is spread like the whole.
        layout: Places of the unknowns.
    """
    prediction = predict_from_others(gated.fit, problem, layout, gated.used)
    rows = np.repeat(gated.used.T, 2, axis=1)
    variances = np.diagonal(prediction.covariances, axis1=1, axis2=2)[rows]
    held_out, expected = np.sqrt(2.0) * rms(prediction.errors[rows]), np.sqrt(2.0) * rms(np.sqrt(variances))
    return Checks(float(held_out), float(expected), *_split_half(gated, problem, layout))


def _split_half(gated: Gated, problem: CalibrationProblem, layout: ParameterLayout) -> tuple[float, float]:
    poses = np.flatnonzero(gated.used.any(axis=0))
    points = problem.workspace.grid()
    images, variances = [], []
    for half in (poses[::2], poses[1::2]):
        part, used = problem.taking(half), gated.used[:, half]
        if np.any(used.sum(axis=1) < problem.fewest_spots):
            return float("nan"), float("nan")
        begin = replace(gated.fit.unknowns, displacements=gated.fit.unknowns.displacements[half])
        fit = maximise_likelihood(begin, part, layout, used)
        if not np.isfinite(fit.chi2):
            return float("nan"), float("nan")
        # Both halves share their priors, so that only what the data make of them can differ.
        posterior = covariance_of(fit.information).matrix
        by_data = posterior @ (fit.information - layout.prior(fit.unknowns).information) @ posterior
        found = fit.unknowns
        images.append(image(found, points))
        variances.append(expected_error(found, by_data, problem.image_sizes, problem.workspace).reprojection_px ** 2)
    whole = gated.fit.unknowns
    pixels = image(whole, points)
    seen = inside(pixels, problem.image_sizes)
    squares = np.where(seen, ((images[0] - images[1]) ** 2).sum(axis=2), np.nan)
    per_point = np.sqrt(np.nansum(squares, axis=0) / np.where(seen.any(axis=0), seen.sum(axis=0), np.nan))
    return rms(per_point), rms(np.sqrt(variances[0] + variances[1]))
