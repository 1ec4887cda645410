"""Chi-square gates: choice of spots explained by the noise, judged without influence of the tested spots.

Where a pose does not fit, one camera's spot is wrong, or the robot's position that all cameras share.
"""

from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.chi_squared import chi2_limit, chi2_median
from im_calibration.estimation.residuals import camera_blocks, linearise, projectable
from im_calibration.estimation.solve import Fit, maximise_likelihood, spot_distances
from im_calibration.estimation.unknowns import ParameterLayout, Unknowns
from im_calibration.problem.problem import CalibrationProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FALSE_ALARM = 5e-4
"""Probability with which a gate rejects an honest pose."""
TRUSTED_SHARE = 0.6
"""Least share of the spots that has to agree; less is not a matter of outliers."""

_AMBIGUOUS = 9.0
_FREE_PX = 200.0  # standard deviation by which an LED that may be anywhere moves in the images
_ROUNDS = 20
_STEPS = 30
_LEAST_SHARE, _WORST_SHARE = 0.5, 0.1
_RIDGE = 1e-12


@dataclass(frozen=True)
class Prediction:
    """Predicted spots of n poses in c cameras, each pose predicted from the others.

    Attributes:
        errors: Measured minus predicted, shape (n, 2c) [px].
        covariances: Covariances of `errors`, shape (n, 2c, 2c) [px^2].
        by_point: Derivatives of the spots by the LED position, shape (n, 2c, 3) [px/m].
    """

    errors: Array
    covariances: Array
    by_point: Array

    def distance(self, pose: int, cameras: NDArray[np.intp], *, scale: float = 1.0, free: bool = False) -> float:
        """Squared Mahalanobis length of the errors of some cameras.

        Args:
            pose: Index of the pose.
            cameras: Indices of the cameras.
            scale: Factor on the covariance.
            free: Whether the LED may be anywhere, so that only contradictions between the cameras count.
        """
        rows = np.stack((2 * cameras, 2 * cameras + 1), axis=1).ravel()
        covariance = scale * self.covariances[pose][np.ix_(rows, rows)]
        if free:
            moved = self.by_point[pose][rows]
            most = float(np.linalg.norm(moved, axis=1).max())
            if most > 0.0:  # else it is where no camera sees that it moves
                covariance = covariance + (_FREE_PX / most) ** 2 * moved @ moved.T
        errors = self.errors[pose][rows]
        return float(errors @ np.linalg.solve(covariance, errors))


class Agreement:
    """Decides for each pose which cameras' spots agree with the prediction and with each other."""

    def __init__(self, prediction: Prediction, detected: Mask, scale: float) -> None:
        """Prepare the decision.

        Args:
            prediction: Spots as predicted from the other poses.
            detected: Which spots there are, shape (c, n).
            scale: Factor on all covariances.
        """
        self._prediction, self._detected, self._scale = prediction, detected, scale

    def usable(self) -> Mask:
        """Mark the usable spots, shape (c, n)."""
        rows = np.repeat(self._detected.T, 2, axis=1)
        both = rows[:, :, None] & rows[:, None, :]
        covariances = np.where(both, self._scale * self._prediction.covariances, np.eye(rows.shape[1]))
        errors = np.where(rows, self._prediction.errors, 0.0)
        squared = (errors * np.linalg.solve(covariances, errors[..., None])[..., 0]).sum(axis=1)
        gates = np.array([0.0, *(_gate(2 * count) for count in range(1, len(self._detected) + 1))])
        chosen = self._detected & (squared <= gates[self._detected.sum(axis=0)])
        for pose in np.flatnonzero(self._detected.any(axis=0) & ~chosen.any(axis=0)):
            chosen[self._cameras(int(pose)), pose] = True
        return np.asarray(chosen)

    def _cameras(self, pose: int) -> list[int]:
        """Return the cameras with usable spots where not all are; empty if the wrong camera cannot be identified.

        A camera is to blame only if the spots contradict each other wherever the LED was; if they do not, the robot's
        position may be wrong as well, and the whole pose goes.
        """
        seen = np.flatnonzero(self._detected[:, pose])
        contradiction = self._prediction.distance(pose, seen, scale=self._scale, free=True)
        if len(seen) < 2 or contradiction <= _gate(2 * len(seen) - 3):
            return []
        for size in range(len(seen) - 1, 0, -1):
            sets = sorted((self._distance(pose, np.array(subset)), subset) for subset in combinations(seen, size))
            if sets[0][0] <= _gate(2 * size):
                ambiguous = len(sets) > 1 and sets[1][0] - sets[0][0] < _AMBIGUOUS
                return [] if ambiguous else [int(c) for c in sets[0][1]]
        return []

    def _distance(self, pose: int, cameras: NDArray[np.intp]) -> float:
        return self._prediction.distance(pose, cameras, scale=self._scale)


@dataclass(frozen=True)
class Gated:
    """Fit to the spots passed by the gates.

    Attributes:
        fit: The maximum-likelihood fit to `used`.
        used: Spots that passed, shape (c, n).
        distances: Squared Mahalanobis length of each spot's own prediction error, NaN where not seen, shape (c, n).
        scale: Factor on the noise variance by which the gates had to be widened; 1 for data as good as they say.
    """

    fit: Fit
    used: Mask
    distances: Array
    scale: float


def fit_with_gates(first: Unknowns, problem: CalibrationProblem, layout: ParameterLayout) -> Gated:
    """Alternate between gates and maximum likelihood until the set of spots no longer changes.

    Where gates at the stated noise would leave out more than outliers explain, the noise is larger than stated (or the
    model is wrong): the gates then widen with the scatter of the typical pose, so that the misfit is seen and not
    sorted away.
    """
    gated = _iterate(first, problem, layout, widen=False)
    if gated.used.sum() >= TRUSTED_SHARE * problem.detected.sum():
        return gated
    return _iterate(first, problem, layout, widen=True)


def predict_from_others(fit: Fit, problem: CalibrationProblem, layout: ParameterLayout, used: Mask) -> Prediction:
    """Predict the spots of each pose from all other poses, but those of the same reading of the robot.

    Departure a reading out takes its share from the information; the parameters then have covariance P', move by
    ``-P' J^T S^-1 r``, and the reading's spots deviate with covariance ``S + J P' J^T``. A spot may thus return once
    what spoiled the estimate is gone. What the positions of a reading are off together is part of S here, and no
    unknown. Source: Cook and Weisberg, "Residuals and Influence in Regression" (1982), chapter 2.

    Args:
        fit: A fit to `used`.
        problem: The observations.
        layout: Places of the unknowns.
        used: Which spots counted, shape (c, n).
    """
    line = linearise(fit.unknowns, problem, layout, problem.detected & projectable(fit.unknowns, problem))
    table, width = problem.poses_of_readings, line.residuals.shape[1]
    shared, by_reading = layout.shared_slice, problem.by_reading
    kept = np.r_[0 : shared.start, shared.stop : layout.size]
    residuals = by_reading(line.residuals + line.jacobians[:, :, shared] @ fit.unknowns.shared_errors)
    rows = by_reading(np.repeat(used.T, 2, axis=1).astype(float)) > 0.0
    all_jacobians = by_reading(line.jacobians[:, :, kept])
    together = by_reading(line.by_point @ problem.shared_roots)
    covariances = together @ np.swapaxes(together, 1, 2) + problem.joined(line.covariances, 1.0)
    both = rows[:, :, None] & rows[:, None, :]
    across = fit.information[kept, shared]
    information = fit.information[np.ix_(kept, kept)]
    information = information - across @ np.linalg.solve(fit.information[shared, shared], across.T)
    diagonal = np.sqrt(np.maximum(np.diag(information), 1e-300))
    whole = np.linalg.inv(information / diagonal[:, None] / diagonal[None, :] + _RIDGE * np.eye(len(kept)))
    spread = (all_jacobians @ (whole / diagonal[:, None] / diagonal[None, :])) @ np.swapaxes(all_jacobians, 1, 2)
    from_used = np.where(rows[:, None, :], spread, 0.0)
    # without the reading, J P' J^T = B + B (S - B)^-1 B with B = J P J^T: no inverse as large as the unknowns are many
    left = np.where(both, covariances - spread, np.eye(rows.shape[1]))
    gain = from_used @ np.linalg.inv(left)
    errors = residuals + (gain @ np.where(rows, residuals, 0.0)[..., None])[..., 0]
    covariances = covariances + spread + gain @ np.swapaxes(from_used, 1, 2)
    own_errors, own_covariances = np.empty_like(line.residuals), np.empty_like(line.covariances)
    for number, poses in enumerate(table.T):
        block = slice(number * width, (number + 1) * width)
        own_errors[poses[poses >= 0]] = errors[poses >= 0, block]
        own_covariances[poses[poses >= 0]] = covariances[poses >= 0, block, block]
    return Prediction(own_errors, own_covariances, line.by_point)


def _iterate(first: Unknowns, problem: CalibrationProblem, layout: ParameterLayout, *, widen: bool) -> Gated:
    """Iterate to a stable set; once sets recur, spots may only leave, so the iteration ends."""
    detected = problem.detected
    unknowns, used, scale = first, _first_gate(first, problem, layout), 1.0
    history: set[bytes] = set()
    recurring = False
    while True:
        fit = maximise_likelihood(unknowns, problem, layout, used, max_steps=_STEPS)
        unknowns = fit.unknowns
        prediction = predict_from_others(fit, problem, layout, used)
        if widen:
            scale = _noise_scale(prediction, used)
        chosen = Agreement(prediction, detected, scale).usable()
        recurring = recurring or chosen.tobytes() in history or len(history) >= _ROUNDS
        if recurring:
            chosen &= used  # a spot may only leave: the iteration ends
        enough = _enough(chosen, problem, layout)
        if not enough:  # what is used contradicts itself so much that nothing agrees with it: the worst has to go
            chosen = _without_worst(used, _own_distances(prediction))
            enough = _enough(chosen, problem, layout) and chosen.sum() >= _LEAST_SHARE * detected.sum()
        if np.array_equal(chosen, used) or not enough:
            if fit.steps == _STEPS:  # steps were few, for speed: now to the end
                fit = maximise_likelihood(unknowns, problem, layout, used)
            return Gated(fit, used, np.where(detected, _own_distances(prediction), np.nan), scale)
        history.add(used.tobytes())
        used = chosen


def _without_worst(used: Mask, distances: Array) -> Mask:
    """Return the used spots without the farthest from the prediction by the other poses: a tenth, at least one."""
    order = np.argsort(np.where(used, -distances, np.inf), axis=None, kind="stable")
    fewer = used.copy()
    fewer.flat[order[: max(1, round(_WORST_SHARE * int(used.sum())))]] = False
    return fewer


def _noise_scale(prediction: Prediction, used: Mask) -> float:
    """Return the ratio of noise variance to stated variance, by the median pose; 1 unless clearly larger."""
    poses = np.flatnonzero(used.any(axis=0))
    ratios = []
    for pose in poses:
        cameras = np.flatnonzero(used[:, pose])
        ratios.append(prediction.distance(int(pose), cameras) / chi2_median(2 * len(cameras)))
    scale = float(np.median(ratios))
    return scale if scale > 1.0 + 3.0 / np.sqrt(len(poses)) else 1.0


def _first_gate(unknowns: Unknowns, problem: CalibrationProblem, layout: ParameterLayout) -> Mask:
    """Apply a generous gate to the robust fit: each spot alone, widened by the scatter of the typical spot."""
    seen = problem.detected & projectable(unknowns, problem)
    unknowns = replace(unknowns, displacements=np.zeros_like(problem.positions))
    distances = spot_distances(linearise(unknowns, problem, layout, seen))
    typical = float(np.median(distances[seen])) / chi2_median(2)
    gate = chi2_limit(FALSE_ALARM, 2) * max(1.0, typical)
    chosen = np.asarray(seen & (distances <= gate))
    return chosen if _enough(chosen, problem, layout) else seen


def _own_distances(prediction: Prediction) -> Array:
    spots = np.swapaxes(prediction.errors.reshape(len(prediction.errors), -1, 2), 0, 1)
    solved = np.linalg.solve(camera_blocks(prediction.covariances), spots[..., None])[..., 0]
    return np.asarray(np.maximum((spots * solved).sum(axis=2), 0.0))


def _enough(chosen: Mask, problem: CalibrationProblem, layout: ParameterLayout) -> bool:
    """Check whether each camera keeps more coordinates than unknowns."""
    return bool(np.all(chosen.sum(axis=1) > problem.fewest_spots)) and 2 * int(chosen.sum()) > layout.free_size


@cache
def _gate(dof: int) -> float:
    """Return the value exceeded by chi-square with probability :data:`FALSE_ALARM`."""
    return float(chi2_limit(FALSE_ALARM, dof))
