"""Smooth error of the arm: size by the residuals of a fit, and the fit anew.

The coefficients of the error are unknowns with a prior, so that their covariance is in that of the cameras. Their
standard deviation is the root of the mean of t^2 by the restricted likelihood: cameras take up much of such an error,
so that the likeliest t is often 0 where t is not. With the cameras eliminated, the information on the coefficients is
diagonal in some axes, with information d and pull z along each; minus twice the logarithm of the likelihood is then

    sum log(1 + t^2 d / v) - sum t^2 z^2 / (v^2 (1 + t^2 d / v)) + R / v + N log v

with R the squared residuals without it, N their degrees of freedom, and v the factor on the variance of the noise. The
factor is free: noise that is larger than stated leaves large residuals everywhere, and must not pass for an arm.
Source: Harville, "Maximum likelihood approaches to variance component estimation" (1977).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.gates import Gated, fit_with_gates
from im_calibration.estimation.noise import NoiseLikelihood
from im_calibration.estimation.residuals import linearise
from im_calibration.estimation.unknowns import ParameterLayout
from im_calibration.problem.arm_error import ArmError
from im_calibration.problem.problem import CalibrationProblem

Array = NDArray[np.float64]

_FACTORS = np.geomspace(1e-2, 1.0, 41)
_USUAL = 0.2
_GAIN = 4.0
_EVEN, _IGNORED = 0.5, 0.05  # probabilities of an error of the arm: before the data, and of too little to count
_REPEATABILITY = 1e-4  # share of the extent of its positions to which no arm, calibrated or not, knows them
_ROUNDS, _CONVERGED = 4, 0.1
_NONE, _LEAST = 16.0, 1e-3


@dataclass(frozen=True)
class Explanation:
    """Fit and the solved problem.

    Attributes:
        problem: The observations, with the error of the arm and the noise as they were taken.
        layout: Places of the unknowns.
        gated: The fit.
    """

    problem: CalibrationProblem
    layout: ParameterLayout
    gated: Gated


def with_usual_arm(problem: CalibrationProblem) -> CalibrationProblem:
    """Return the problem with a usual error of the arm, where such an error is expected: gates need some size."""
    if problem.arm_jacobians is None and problem.reading_error is None:
        return problem
    whole = problem.largest_arm_error
    return replace(problem, arm_error=whole.times(np.full(len(whole.sizes), _USUAL)))


def with_arm_error(gated: Gated, problem: CalibrationProblem, *, robot_known: bool = True) -> Explanation:
    """Return the fit with the smooth error of the arm, as large as the residuals make likely.

    An arm has such an error, of a size that the data leave possible. Where the kinematics are not given, and the noise
    of the robot is stated, as more than arms repeat a place, it may have none: both are as likely before. If the data
    then leave little of the error, the fit is unchanged.

    Args:
        gated: A fit without such an error, or with a usual one.
        problem: What it was made from.
        robot_known: Whether the noise of the robot is stated.
    """
    if problem.placements is not None and problem.arm_jacobians is None and problem.reading_error is None:
        return Explanation(problem, ParameterLayout.of(problem), gated)  # a target without a robot
    whole = problem.largest_arm_error
    before_data = _before_data(problem) if robot_known and problem.arm_jacobians is None else 1.0
    factors = np.zeros(len(whole.sizes)) if problem.arm_error is None else problem.arm_error.sizes / whole.sizes
    found = Explanation(problem, ParameterLayout.of(problem), gated)
    for _ in range(_ROUNDS):
        before, factors = factors, _factors(found, whole, before_data)
        if np.all(abs(factors - before) <= _CONVERGED * before):
            break
        bent = replace(problem, arm_error=whole.times(factors) if factors.any() else None)
        layout = ParameterLayout.of(bent)
        unknowns = found.gated.fit.unknowns
        again = before.any() and factors.any()
        scaled = unknowns.arm_error * (before / factors)[whole.kinds] if again else np.zeros(layout.arm)
        found = Explanation(bent, layout, fit_with_gates(replace(unknowns, arm_error=scaled), bent, layout))
        if not factors.any():
            break
    return found


def _before_data(problem: CalibrationProblem) -> float:
    """Return the probability of an error of the arm before the data, by the stated noise of the robot."""
    noise = np.trace(problem.position_covariances, axis1=1, axis2=2).mean() / 3.0
    if noise == 0.0:
        return _IGNORED  # the positions are said to be exact: only data that speak for an error make it count
    return 1.0 if noise < _REPEATABILITY**2 * problem.positions.var(axis=0).sum() else _EVEN


def _factors(found: Explanation, whole: ArmError, before_data: float) -> Array:
    """Return mean factors on the largest error by the likelihood of each size, 0 where no size is likely.

    Args:
        found: A fit.
        whole: The largest error.
        before_data: Probability that there is an error, before the data; each size is as likely then.
    """
    problem = replace(found.problem, arm_error=whole)
    layout = ParameterLayout.of(problem)
    unknowns, present = found.gated.fit.unknowns, found.problem.arm_error
    sizes = np.zeros(1) if present is None else (present.sizes / whole.sizes)[whole.kinds]
    coefficients = sizes * unknowns.arm_error if present is not None else np.zeros(layout.arm)
    unknowns = replace(unknowns, arm_error=coefficients)
    if problem.reading_error is not None:
        return _of_readings(NoiseLikelihood(unknowns, problem, layout, found.gated.used, bent=True))
    line = linearise(unknowns, problem, layout, found.gated.used)
    arm, rest = layout.arm_slice, slice(0, layout.size - layout.arm)
    residuals = line.residuals + line.jacobians[:, :, arm] @ coefficients
    weighted = np.linalg.inv(line.covariances) @ line.jacobians
    rows = line.jacobians.reshape(-1, layout.size)
    information = rows.T @ weighted.reshape(-1, layout.size)
    pull = weighted.reshape(-1, layout.size).T @ residuals.ravel()
    prior = layout.prior(unknowns)
    own = information[rest, rest] + prior.information[rest, rest]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(own), 1e-300))
    own = own * scale[:, None] * scale + 1e-12 * np.eye(len(scale))
    cross = information[rest, arm] * scale[:, None]
    shift = np.linalg.solve(own, np.column_stack((cross, (pull[rest] + prior.gradient[rest]) * scale)))
    d, axes = np.linalg.eigh(information[arm, arm] - cross.T @ shift[:, :-1])
    z2 = (axes.T @ (pull[arm] - cross.T @ shift[:, -1])) ** 2
    squared = float(np.einsum("ni,nij,nj->", residuals, np.linalg.inv(line.covariances), residuals))
    squared -= float((pull[rest] + prior.gradient[rest]) * scale @ shift[:, -1])
    freedom = max(1, 2 * int(found.gated.used.sum()) - layout.free_size)
    d = np.maximum(d, 0.0)
    t2 = np.concatenate(([0.0], _FACTORS**2))[:, None]  # over the variance of the noise
    left = squared - (t2 * z2 / (1.0 + t2 * d)).sum(axis=1)
    noise = np.maximum(left / freedom, 1e-12)
    deviance = freedom * np.log(noise) + left / noise + np.log1p(t2 * d).sum(axis=1)
    likelihood = np.exp(-0.5 * (deviance - deviance.min()))
    possible = before_data * _FACTORS / _FACTORS.sum() * likelihood[1:]  # alike for each size, not each logarithm
    every = possible.sum() + (1.0 - before_data) * likelihood[0]
    if possible.sum() < _IGNORED * every:
        return np.zeros(1)
    return np.asarray(np.sqrt((possible * np.minimum(t2[1:, 0] * noise[1:], 1.0)).sum(keepdims=True) / every))


def _of_readings(likelihood: NoiseLikelihood) -> Array:
    """Return factors on shifts and turns of greatest likelihood, with any noise; 0 where noise alone does as well."""
    noise, none = np.array([True, True, False, False]), np.array([0.0, 0.0, -_NONE, -_NONE])
    logs, without = likelihood.maximum(none, noise)
    starts = (np.log([1.0, less, size, size]) * 2.0 for size in (0.03, _USUAL) for less in (1.0, 0.1))
    logs, least = likelihood.maximum(min(starts, key=likelihood.deviance), np.ones(4, bool))
    if without - least < _GAIN:
        return np.zeros(2)
    return np.clip(np.exp(logs[2:] / 2.0), _LEAST, 1.0)
