"""Maximum likelihood of all unknowns and all LED positions together, by Levenberg-Marquardt; and a robust form."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.residuals import Linearisation, camera_blocks, image_residuals, linearise, projectable
from im_calibration.estimation.unknowns import ParameterLayout, Unknowns
from im_calibration.problem.problem import CalibrationProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MEDIAN_CHI2_2 = 2.0 * np.log(2.0)
_ROBUST_ROUNDS = 40
_ROBUST_SCALE_FLOOR = 9.0
_ROBUST_CONVERGED = 1e-4
_MAX_STEPS = 100
_CONVERGED = 1e-7
_DAMPING_LIMIT = 1e10
_FOCAL_RANGE = (0.02, 100.0)  # in image widths: beyond is no camera


@dataclass(frozen=True)
class Fit:
    """A minimum of the (possibly weighted) chi-square.

    Attributes:
        unknowns: The estimate.
        information: Normal matrix of the parameters with the priors, LED positions eliminated, shape (size, size).
        chi2: Squared Mahalanobis length of the image residuals, the displacements and the priors.
        linearisation: The problem at the estimate.
        steps: Number of accepted steps.
    """

    unknowns: Unknowns
    information: Array
    chi2: float
    linearisation: Linearisation
    steps: int


def maximise_likelihood(
    start: Unknowns,
    problem: CalibrationProblem,
    layout: ParameterLayout,
    used: Mask,
    inflation: Array | None = None,
    max_steps: int = _MAX_STEPS,
) -> Fit:
    """Iterate to the maximum of the likelihood of the counted spots.

    Args:
        start: Where to begin; every used spot must lie in front of its camera.
        problem: The observations.
        layout: Places of the unknowns.
        used: Which spots count, shape (c, n).
        inflation: Factors on the image noise of each spot (inverse robust weights), shape (c, n); None: 1.
        max_steps: Bound on the number of steps.

    Returns:
        The fit. In directions that the data do not determine it stays where damping stops it; its information says so.
    """
    cost = _Cost(problem, layout, used, inflation)
    unknowns = cost.relaxed(start)
    chi2 = cost(unknowns)
    damping, steps = 1e-4, 0
    while True:
        line = linearise(unknowns, problem, layout, used, cost.image_covariances)
        weights: Array = np.asarray(np.linalg.inv(line.covariances), dtype=np.float64)
        information, gradient = _normal_equations(line, weights, unknowns, layout)
        diagonal = np.diag(information)
        # of pixels, radians and metres: one damping is to fit all
        scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.maximum(diagonal, 1e-300)), 0.0)
        scaled = information * scale[:, None] * scale[None, :]
        improved = False
        while not improved and damping < _DAMPING_LIMIT and steps < max_steps:
            step = scale * np.linalg.solve(scaled + damping * np.eye(layout.size), scale * gradient)
            candidate = unknowns.moved(step, layout, _displacements(line, weights, step, problem))
            candidate_chi2 = cost(candidate)
            improved = np.isfinite(candidate_chi2) and candidate_chi2 <= chi2 * (1.0 + 1e-12)  # rounding is no rise
            if not improved:
                damping = max(damping, 1e-6) * 10.0
        if not improved:
            return Fit(unknowns, information, chi2, line, steps)
        small = float(step @ information @ step) < _CONVERGED**2 * layout.size
        unknowns, chi2, damping, steps = candidate, candidate_chi2, max(damping * 0.1, 1e-15), steps + 1
        if small:
            return Fit(unknowns, information, chi2, line, steps)


def robust_fit(
    start: Unknowns, problem: CalibrationProblem, layout: ParameterLayout, used: Mask, rounds: int = _ROBUST_ROUNDS
) -> Fit:
    """Fit with the Geman-McClure loss on each spot; the scale follows the median of the residuals down.

    Args:
        start: Where to begin.
        problem: The observations.
        layout: Places of the unknowns.
        used: Spots to consider, shape (c, n); those behind their camera are ignored while they are.
        rounds: Bound on the number of changes of scale.

    Returns:
        A fit that gross outliers have hardly moved; its chi-square is the weighted one.
    """
    unknowns = start
    previous = np.inf
    for _ in range(rounds):
        unknowns = replace(unknowns, displacements=np.zeros_like(problem.positions))
        visible = used & projectable(unknowns, problem)
        distances = spot_distances(linearise(unknowns, problem, layout, visible))
        scale = max(_ROBUST_SCALE_FLOOR, 4.0 * float(np.median(distances[visible])) / _MEDIAN_CHI2_2)
        inflation = (1.0 + distances / scale) ** 2
        fit = maximise_likelihood(unknowns, problem, layout, visible, inflation, max_steps=3)
        cost = float((distances[visible] / (distances[visible] + scale)).sum()) + scale
        unknowns = fit.unknowns
        if abs(previous - cost) < _ROBUST_CONVERGED * cost:
            break
        previous = cost
    return fit


def robust_cost(unknowns: Unknowns, problem: CalibrationProblem, layout: ParameterLayout) -> float:
    """Return the misfit of all spots, from 0 to the number of spots; gross outliers count 1 each."""
    still = replace(unknowns, displacements=np.zeros_like(problem.positions))
    visible = problem.detected & projectable(still, problem)
    distances = spot_distances(linearise(still, problem, layout, visible))[visible]
    missed = float(problem.detected.sum() - visible.sum())
    return missed + float((distances / (distances + _ROBUST_SCALE_FLOOR)).sum())


def spot_distances(line: Linearisation) -> Array:
    """Return the squared Mahalanobis length of each spot's own residual, shape (c, n)."""
    blocks = camera_blocks(line.covariances)
    residuals = np.swapaxes(line.residuals.reshape(len(line.residuals), -1, 2), 0, 1)
    return np.asarray((residuals * np.linalg.solve(blocks, residuals[..., None])[..., 0]).sum(axis=2))


class _Cost:
    """Chi-square of a value of all unknowns, LED positions included."""

    def __init__(
        self, problem: CalibrationProblem, layout: ParameterLayout, used: Mask, inflation: Array | None
    ) -> None:
        self._problem, self._layout, self._used = problem, layout, used
        self._widths = np.array([[size[0]] for size in problem.image_sizes], dtype=float)
        factors = np.ones(used.shape) if inflation is None else np.where(used, inflation, 1.0)
        noise = np.where(used[..., None, None], problem.spot_covariances, np.eye(2))
        self.image_covariances: Array = noise * factors[..., None, None]
        self._image_weights = np.swapaxes(np.linalg.inv(self.image_covariances), 0, 1)
        self._position_weights = problem.position_weights

    def __call__(self, unknowns: Unknowns) -> float:
        focal = unknowns.intrinsics[:, :2] / self._widths
        if not np.all((focal > _FOCAL_RANGE[0]) & (focal < _FOCAL_RANGE[1])):
            return float("inf")
        residuals = image_residuals(unknowns, self._problem, self._used)
        if residuals is None:
            return float("inf")
        residuals = residuals.reshape(len(residuals), -1, 2)
        image = np.einsum("nci,ncij,ncj->", residuals, self._image_weights, residuals)
        moved = unknowns.displacements
        position = np.einsum("ni,nij,nj->", moved, self._position_weights, moved)
        return float(image + position + self._layout.prior_chi2(unknowns))

    def relaxed(self, unknowns: Unknowns) -> Unknowns:
        """Return the same cameras with the best matching LED positions, to first order."""
        line = linearise(unknowns, self._problem, self._layout, self._used, self.image_covariances)
        still = np.zeros(self._layout.size)
        weights: Array = np.asarray(np.linalg.inv(line.covariances), dtype=np.float64)
        moved = _displacements(line, weights, still, self._problem)
        candidate = replace(unknowns, displacements=moved)
        return candidate if self(candidate) < self(unknowns) else unknowns


def _displacements(line: Linearisation, weights: Array, step: Array, problem: CalibrationProblem) -> Array:
    """Return the LED displacements for a step: back-substitution of the Schur complement, shape (n, 3) [m]."""
    remaining = line.residuals - line.jacobians @ step
    force = np.swapaxes(line.by_point, 1, 2) @ (weights @ remaining[..., None])
    return np.asarray((problem.own_covariances @ force)[..., 0])


def _normal_equations(
    line: Linearisation, weights: Array, unknowns: Unknowns, layout: ParameterLayout
) -> tuple[Array, Array]:
    """Information matrix and right-hand side, priors included."""
    seen, prior = line.by_point.any(axis=2), layout.prior(unknowns)  # of several cameras, few see a point
    weighted = weights @ line.jacobians
    jacobians, weighted = (line.jacobians, weighted) if seen.all() else (line.jacobians[seen], weighted[seen])
    weighted = weighted.reshape(-1, layout.size)
    information = jacobians.reshape(-1, layout.size).T @ weighted + prior.information
    gradient = weighted.T @ line.residuals[seen] + prior.gradient
    return (information + information.T) / 2.0, gradient
