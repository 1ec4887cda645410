"""Size of the arm's smooth error, from the residuals of a fit, and the fit with it.

The coefficients of the error are unknowns with a prior, so that their covariance is in that of the cameras. The error's
standard deviation t, the share of the wrist in it, and a factor r on the variance of the robot's noise maximise the
restricted likelihood: an arm that was stated by the size of its error has less noise than that. With the cameras
eliminated, the information on the coefficients is diagonal in some axes, with information d and pull z along each;
minus twice the logarithm of the likelihood is then, but for what depends on r alone,

    sum log(1 + t^2 d / v) - sum t^2 z^2 / (v^2 (1 + t^2 d / v)) + R / v + N log v

with R the squared residuals without it, N their degrees of freedom, and v a factor on the variance of all noise. It is
free: noise that is larger than stated leaves large residuals everywhere, and must not pass for an arm.
Source: Harville, "Maximum likelihood approaches to variance component estimation" (1977).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.gates import Gated, fit_with_gates
from im_calibration.estimation.residuals import linearise
from im_calibration.estimation.unknowns import ParameterLayout
from im_calibration.problem.arm_error import WRIST_SHARES, ArmError
from im_calibration.problem.problem import CalibrationProblem

Array = NDArray[np.float64]

_FACTORS = np.geomspace(1e-2, 1.0, 41)
_ROBOT_FACTORS = (1.0, 0.01, 0.1, 0.3, 0.6, 4.0, 25.0)  # r, on variances
_GAIN = 4.0
_ROUNDS, _CONVERGED = 4, 0.1


@dataclass(frozen=True)
class Explanation:
    """Fit with the problem that it solves.

    Attributes:
        problem: The observations, with the error of the arm and the noise as they were taken.
        layout: Places of the unknowns.
        gated: The fit.
        robot_scale: Factor on the robot's standard deviations of `problem`, beside the smooth error.
    """

    problem: CalibrationProblem
    layout: ParameterLayout
    gated: Gated
    robot_scale: float = 1.0


def with_arm_error(gated: Gated, problem: CalibrationProblem, *, robot_known: bool = True) -> Explanation:
    """Return the fit with the smooth error of the arm that the residuals show.

    Where the noise of the robot is stated, the data have to show the error; if they do not, the fit is unchanged. Where
    that noise is not stated, an arm has such an error, of a size that the data leave possible.

    Args:
        gated: A fit without such an error.
        problem: What it was made from.
        robot_known: Whether the noise of the robot is stated.
    """
    straight = replace(problem, arm_error=None)
    found = Explanation(problem, ParameterLayout.of(problem), gated)
    if problem.placements is not None:  # a target's own place takes up what is alike at neighbours
        return found
    for _ in range(_ROUNDS):
        try:
            error, robot = _likeliest(found, straight, robot_known=robot_known)
        except np.linalg.LinAlgError:  # cameras so wrong that they hide the noise of the spots tell nothing of an arm
            return Explanation(straight, ParameterLayout.of(straight), gated)
        before, unknowns = found.problem.arm_error, found.gated.fit.unknowns
        if error is None and before is None:
            break
        old, new = (0.0 if each is None else each.standard_deviation for each in (before, error))
        bent = replace(straight.with_noise(1.0, robot), arm_error=error)
        layout = ParameterLayout.of(bent)
        coefficients = np.zeros(layout.arm)
        if old and len(unknowns.arm_error) == layout.arm:
            coefficients = unknowns.arm_error * (old / new)
        fit = fit_with_gates(replace(unknowns, arm_error=coefficients), bent, layout)
        found = Explanation(bent, layout, fit, robot)
        if error is None or abs(new - old) <= _CONVERGED * old:
            break
    return found


def _likeliest(found: Explanation, straight: CalibrationProblem, *, robot_known: bool) -> tuple[ArmError | None, float]:
    """Find error and factor on the robot's standard deviations: of greatest likelihood, or the mean of all sizes."""
    unknowns, used, present = found.gated.fit.unknowns, found.gated.used, found.problem.arm_error
    line = linearise(unknowns, found.problem, found.layout, used)
    residuals = line.residuals
    if present is not None:
        residuals = residuals + np.einsum("nui,nik,k->nu", line.by_point, present.jacobians, unknowns.arm_error)
    rest = found.layout.size - found.layout.arm
    prior, shared = found.layout.prior(unknowns), found.layout.shared_slice
    free = max(1, 2 * int(used.sum()) - found.layout.free_size)
    of_robot = line.by_point @ straight.own_covariances @ np.swapaxes(line.by_point, 1, 2)
    of_image = line.covariances - line.by_point @ found.problem.own_covariances @ np.swapaxes(line.by_point, 1, 2)
    whole = {
        share: ArmError.largest(straight.positions, straight.wrist_rotations, share)
        for share in (WRIST_SHARES if np.ptp(straight.wrist_rotations, axis=0).max() > 0.0 else WRIST_SHARES[:1])
    }
    t2 = np.concatenate(([0.0], _FACTORS**2))[:, None]  # over the variance of the noise
    best, straight_deviance = (np.inf, 0.0, 1.0, 1.0, np.zeros(0), np.zeros(0)), np.inf
    noisy = robot_known and (bool(of_robot.any()) or shared.stop > shared.start)
    for robot in _ROBOT_FACTORS if noisy else _ROBOT_FACTORS[:1]:
        lower = np.linalg.cholesky(of_image + robot * of_robot)
        by_rest, points, off = (
            np.linalg.solve(lower, each).reshape(lower.shape[0] * lower.shape[1], -1)
            for each in (line.jacobians[:, :, :rest], line.by_point, residuals[..., None])
        )
        information, gradient = prior.information[:rest, :rest].copy(), prior.gradient[:rest].copy()
        information[shared, shared] /= robot
        gradient[shared] /= robot
        own = by_rest.T @ by_rest + information
        scale = 1.0 / np.sqrt(np.maximum(np.diag(own), 1e-300))
        root = np.linalg.cholesky(own * scale[:, None] * scale + 1e-12 * np.eye(rest))
        pull = np.linalg.solve(root, (by_rest.T @ off[:, 0] + gradient) * scale)
        squared = float(off[:, 0] @ off[:, 0] - pull @ pull)
        constant = 2.0 * float(
            np.log(np.diagonal(lower, axis1=1, axis2=2)).sum() + np.log(np.diag(root)).sum() - np.log(scale).sum()
        ) + (shared.stop - shared.start) * np.log(robot)
        for share, error in whole.items():
            by_arm = (points.reshape(*lower.shape[:2], 3) @ error.jacobians).reshape(len(points), -1)
            cross = np.linalg.solve(root, (by_rest.T @ by_arm) * scale[:, None])
            d, axes = np.linalg.eigh(by_arm.T @ by_arm - cross.T @ cross)
            z2, d = (axes.T @ (by_arm.T @ off[:, 0] - cross.T @ pull)) ** 2, np.maximum(d, 0.0)
            left = squared - (t2 * z2 / (1.0 + t2 * d)).sum(axis=1)
            noise = np.maximum(left / free, 1e-12)
            deviance = free * np.log(noise) + left / noise + np.log1p(t2 * d).sum(axis=1) + constant
            straight_deviance = min(straight_deviance, float(deviance[0]))
            if deviance.min() < best[0]:
                at = int(np.argmin(deviance))
                best = (float(deviance[at]), float(t2[at, 0] * noise[at]), share, robot * noise[at], deviance, noise)
    least, variance, share, robot, deviance, noise = best
    if not robot_known:
        possible = _FACTORS * np.exp(-0.5 * (deviance - least))[1:]  # alike for each size, not each logarithm
        variance = float((possible * np.minimum(t2[1:, 0] * noise[1:], 1.0)).sum() / possible.sum())
        return whole[share].times(np.sqrt(variance)), 1.0
    if straight_deviance - least < _GAIN:
        return None, 1.0
    return whole[share].times(min(np.sqrt(variance), 1.0)), min(float(np.sqrt(robot)), 1.0)
