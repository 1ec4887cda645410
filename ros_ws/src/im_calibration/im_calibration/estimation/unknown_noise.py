"""The explanation of the spots where the size of the noise is not known: gates and noise found in turns.

Gates need the noise, to tell an outlier from an honest spot, and the noise is that of the honest spots. The median of
a robust fit says how large both are together, whatever up to half of the spots do; from there gates and variance
components go on in turns.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.arm import Explanation, with_arm_error
from im_calibration.estimation.chi_squared import chi2_median
from im_calibration.estimation.gates import TRUSTED_SHARE, Gated, fit_with_gates
from im_calibration.estimation.noise import NoiseFactors, noise_factors, noise_scale
from im_calibration.estimation.residuals import linearise, projectable
from im_calibration.estimation.search import REDUNDANT_SPOTS, best_explanation, robust_start
from im_calibration.estimation.solve import robust_fit, spot_distances
from im_calibration.estimation.unknowns import ParameterLayout, Unknowns
from im_calibration.problem.problem import NOISE_SOURCES, CalibrationProblem

Array = NDArray[np.float64]

_ROUGH, _ROUGH_ROUNDS = 1.5, 4
_LARGER, _LARGER_ROUNDS = 3.0, 4
_FINE, _FINE_ROUNDS = 0.01, 8
_ARM_CONVERGED, _ARM_ROUNDS = 0.05, 4


@dataclass(frozen=True)
class NoiseFound:
    """Explanation of the spots with the matching noise.

    Attributes:
        explanation: The fit, with its noise taken as `scale` says.
        factors: What the residuals say about the stated noise.
        scale: Factors by which the standard deviations of image and robot were multiplied.
    """

    explanation: Explanation
    factors: NoiseFactors
    scale: tuple[float, float]


def find_noise(problem: CalibrationProblem, layout: ParameterLayout, free: tuple[str, ...]) -> NoiseFound:
    """Explain the spots, estimating noise.

    Args:
        problem: The observations, in canonical order if the result shall not depend on the order.
        layout: Places of the unknowns.
        free: Which noises may differ from what is stated, of :data:`im_calibration.problem.problem.NOISE_SOURCES`.

    Raises:
        DegenerateDataError: A camera has too few spots, or the positions lie on a line.
        InconsistentDataError: No camera explains the spots.
    """
    scale = np.where(_free(free), _rough_scale(problem, layout, free), 1.0)
    unknowns = robust_start(problem.with_noise(*scale), layout)
    gated, scale = _settle(unknowns, problem, layout, free, scale)
    if gated.used.sum(axis=1).min() < REDUNDANT_SPOTS:
        searched = best_explanation(problem.with_noise(*scale), layout, gated)
        gated, scale = _settle(searched.fit.unknowns, problem, layout, free, scale)
    for _ in range(_ARM_ROUNDS):
        bent = with_arm_error(gated, problem.with_noise(*scale), robot_known="robot" not in free)
        if bent.problem.arm_error is None:
            break
        problem, layout, before = replace(problem, arm_error=bent.problem.arm_error), bent.layout, scale
        gated, scale = _settle(bent.gated.fit.unknowns, problem, layout, free, scale)
        if np.abs(np.log(scale / before)).max() < _ARM_CONVERGED:
            break
    factors = noise_factors(gated.fit.unknowns, problem, layout, gated.used, free)
    settled = problem.with_noise(*scale)
    return NoiseFound(Explanation(settled, layout, gated), factors, (float(scale[0]), float(scale[1])))


def _settle(
    unknowns: Unknowns, problem: CalibrationProblem, layout: ParameterLayout, free: tuple[str, ...], scale: Array
) -> tuple[Gated, Array]:
    """Alternate gates and variance components; a noise making most spots outliers is too small."""
    gated = fit_with_gates(unknowns, problem.with_noise(*scale), layout)
    for _ in range(_LARGER_ROUNDS):
        if gated.scale == 1.0 and gated.used.sum() >= TRUSTED_SHARE * problem.detected.sum():
            break
        scale = np.where(_free(free), _LARGER * scale, 1.0)
        gated = fit_with_gates(robust_start(problem.with_noise(*scale), layout), problem.with_noise(*scale), layout)
    for _ in range(_FINE_ROUNDS):
        factors = noise_scale(gated.fit.unknowns, problem.with_noise(*scale), layout, gated.used, free)
        if np.abs(np.log(factors)).max() < _FINE:
            break
        scale = scale * factors
        gated = fit_with_gates(gated.fit.unknowns, problem.with_noise(*scale), layout)
    return gated, scale


def _free(free: tuple[str, ...]) -> NDArray[np.bool_]:
    return np.array([source in free for source in NOISE_SOURCES])


def _rough_scale(problem: CalibrationProblem, layout: ParameterLayout, free: tuple[str, ...]) -> float:
    """Factor on the standard deviations by the typical spot of robust fits."""
    scale = 1.0
    unknowns = robust_start(problem, layout)
    for _ in range(_ROUGH_ROUNDS):
        scaled = problem.with_noise(*np.where(_free(free), scale, 1.0))
        factor = _median_factor(unknowns, scaled, layout)
        scale *= factor
        if 1.0 / _ROUGH < factor < _ROUGH:
            break
        scaled = problem.with_noise(*np.where(_free(free), scale, 1.0))
        unknowns = robust_fit(unknowns, scaled, layout, problem.detected).unknowns
    return scale


def _median_factor(unknowns: Unknowns, problem: CalibrationProblem, layout: ParameterLayout) -> float:
    """Return the factor on all standard deviations by the typical spot, independent of the other spots."""
    unknowns = replace(unknowns, displacements=np.zeros_like(problem.positions))
    seen = problem.detected & projectable(unknowns, problem)
    typical = float(np.median(spot_distances(linearise(unknowns, problem, layout, seen))[seen]))
    freedom = max(0.2, 1.0 - layout.size / (2.0 * float(seen.sum())))
    return float(np.sqrt(typical / chi2_median(2) / freedom))
