"""Possible causes of data fitting no camera: slips in the data, an LED elsewhere, a moved robot.

Each cause is tried: the data are changed as if it were so, and a robust fit shows whether the spots are then explained,
and far better than otherwise. What is named is a cause that explains the data, which is not to say that it is the only
one.
"""

from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from im_calibration.errors import DegenerateDataError, InconsistentDataError
from im_calibration.estimation.chi_squared import chi2_median
from im_calibration.estimation.projection import image
from im_calibration.estimation.residuals import linearise, projectable
from im_calibration.estimation.search import robust_start
from im_calibration.estimation.solve import robust_fit, spot_distances
from im_calibration.estimation.start import start
from im_calibration.estimation.unknowns import ParameterLayout, Unknowns
from im_calibration.judgement.slips import slips_of, slips_of_cameras
from im_calibration.problem.problem import CalibrationProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LARGEST_SPOT_PX, LARGEST_ARM_SHARE = 2.0, 3e-3
"""Noise of no spot [px], and of no arm, as a share of the extent of its positions: neither repeats a place so badly."""
MEDIAN_LENGTH = float(np.sqrt(2.0 * np.log(2.0)))
"""Median length of a vector of two coordinates of unit standard deviation."""

_GROSS, _USUAL = 3.0, 1.5  # times the stated noise: less than gross is noise rather than nonsense
_USUAL_SPOT_PX, _USUAL_ARM_SHARE = 0.5, 1e-3
_BETTER, _FAR_BETTER, _RIVAL = 2.0, 4.0, 1.5
_WIDE_SHARE = 0.3  # of the extent of the positions: how far an LED may be from where it is said to be
_MANY = 25
_FAR_SIGMAS, _LARGEST_OFFSET_M = 5.0, 1.0
_EXPLAINED, _FEWEST, _GATE = 0.6, 6, 30.0
_FIRST_ROUNDS, _PROMISING, _ROUNDS = 2, 1.3, 6
_LARGEST_CELL_M = 50.0


@dataclass(frozen=True)
class _Fitted:
    """Robust fit, and the size of its residuals, of the camera where they are largest.

    Attributes:
        unknowns: The fit; None: there is no camera.
        sigmas: Residual of the typical spot over the size explained by the stated noise.
        px: Noise of each image coordinate by the typical spot [px].
        share: The same at the light, as a share of the extent of the positions.
        stated: Whether the noise is stated.
    """

    unknowns: Unknowns | None
    sigmas: float
    px: float
    share: float
    stated: bool

    @property
    def usual(self) -> bool:
        """Whether the residuals are as small as usual noise."""
        if self.stated:
            return self.sigmas < _USUAL
        return self.px < _USUAL_SPOT_PX or self.share < _USUAL_ARM_SHARE

    @property
    def possible(self) -> bool:
        """Whether noise may explain the residuals."""
        if self.stated:
            return self.sigmas < _GROSS
        return self.px < LARGEST_SPOT_PX or self.share < LARGEST_ARM_SHARE

    def explains(self, other: "_Fitted") -> bool:
        """Whether the residuals are noise, and far smaller than those of another fit."""
        return self.possible and self.px * (_BETTER if self.usual else _FAR_BETTER) < other.px


def strange_units(problem: CalibrationProblem) -> str:
    """Return the sentence: positions are too far apart for metres; otherwise empty."""
    spread = np.median(np.linalg.norm(problem.positions - np.median(problem.positions, axis=0), axis=1))
    if spread <= _LARGEST_CELL_M:
        return ""
    return f"Half of the LED positions are {spread:.0f} m and more from their median: are they metres?"


def find_slip(problem: CalibrationProblem) -> str:
    """Return a sentence on the slip that explains residuals larger than usual; empty if there is none.

    Args:
        problem: The observations, in the order in which they were made.
    """
    return "" if problem.placements is not None else _slip(problem, _fit(problem, thoroughly=True))


def find_cause(problem: CalibrationProblem) -> str:
    """Return a sentence on the cause of data fitting no camera unchanged; empty if no cause is found.

    Args:
        problem: The observations, in the order in which they were made.
    """
    if problem.placements is not None:  # slips of targets and robots are looked for before the start
        return ""
    found = _fit(problem, thoroughly=True)
    if sentence := _slip(problem, found) or strange_units(problem) or _led_elsewhere(problem, found):
        return sentence
    if len(problem.positions) < _MANY:  # few poses with outliers can be bent to say so
        return ""
    return _moved(problem, found.unknowns) or ("" if found.sigmas > _GROSS else _led_beyond(problem, found.unknowns))


def _slip(problem: CalibrationProblem, found: _Fitted) -> str:
    """Describe the slip without which the data fit far better than with it, and than without any other."""
    if found.usual:
        return ""
    bad = [c for c in range(len(problem.camera_names)) if not _fit(_of_camera(problem, c)).usual]
    some = slips_of_cameras(problem, bad) if 0 < len(bad) < len(problem.camera_names) else ()
    first = max(found.px, _fit(problem, _FIRST_ROUNDS).px)  # after as few rounds, not after the best of many starts
    promising = [
        slip for slip in chain(slips_of(problem), some) if _PROMISING * _fit(slip.problem, _FIRST_ROUNDS).px < first
    ]
    if not promising:
        return ""
    fits = [_fit(slip.problem) for slip in promising]
    near = _RIVAL * min(fit.px for fit in fits)  # few rounds may end far from the best of a slip
    fits = [
        _fit(slip.problem, thoroughly=True) if fit.px <= near else fit
        for fit, slip in zip(fits, promising, strict=True)
    ]
    tried = sorted(zip(fits, promising, strict=True), key=lambda one: one[0].px)
    best, slip = tried[0]
    if not best.explains(found):
        return ""
    rivals = [other for fitted, other in tried[1:] if fitted.px < _RIVAL * best.px]
    if not all(other.mirror and slip.mirror for other in rivals):
        return ""
    if rivals:
        slip = next(other for _, other in tried if other.mirror)
    before = f" instead of {_two_digits(found.px)} px" if np.isfinite(found.px) else ""
    return f"{slip.sentence} the residual is {_two_digits(best.px)} px{before}."


def _two_digits(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"


def _led_elsewhere(problem: CalibrationProblem, found: _Fitted) -> str:
    """Describe an LED farther from the nominal place than stated."""
    turned = problem.wrist_rotations - problem.wrist_rotations.mean(axis=0)
    if found.sigmas < _GROSS or np.abs(turned).max() < 0.1:
        return ""
    extent = float(np.std(problem.positions, axis=0).max())
    free = _fit(replace(problem, led_offset_prior_sd=max(_WIDE_SHARE * extent, problem.led_offset_prior_sd)))
    return _led_at(problem, free.unknowns.led_offset) if free.unknowns and free.explains(found) else ""


def _led_beyond(problem: CalibrationProblem, unknowns: Unknowns | None) -> str:
    """Describe an LED fitted far from the nominal place, although the place is stated to be known."""
    if unknowns is None or problem.led_offset_prior_sd == 0.0:
        return ""
    return _led_at(problem, unknowns.led_offset)


def _led_at(problem: CalibrationProblem, offset: Array) -> str:
    if not _FAR_SIGMAS * problem.led_offset_prior_sd < np.abs(offset).max() < _LARGEST_OFFSET_M:
        return ""
    known = f"known to {1e3 * problem.led_offset_prior_sd:.0f} mm" if problem.led_offset_prior_sd else "exact"
    return (
        f"The LED is about ({_millimetres(offset)}) mm, in the wrist frame, from its nominal place: with that the "
        f"spots fit, and the nominal place is stated to be {known}."
    )


def _millimetres(vector: Array) -> str:
    return ", ".join(f"{value:.0f}" for value in np.round(1e3 * vector) + 0.0)


def _moved(problem: CalibrationProblem, whole: Unknowns | None) -> str:
    """Describe a move between two poses: of the robot's base, or of all cameras together."""
    n = len(problem.positions)
    for half in (np.arange(n // 2), np.arange(n // 2, n)):
        part = problem.taking(half)
        fitted = _fit(part)
        if fitted.unknowns is None or not fitted.possible:
            continue
        # the readings of the other half are not those of this one
        unknowns = replace(fitted.unknowns, shared_errors=np.zeros(problem.shared_errors.shape[2]))
        tolerance = _GATE * max(1.0, fitted.sigmas) ** 2
        stay = _explained(problem, unknowns, tolerance)
        others = problem.detected.any(axis=0) & ~stay
        if others.sum() < _FEWEST or (whole is not None and _explained(problem, whole, tolerance).sum() > stay.sum()):
            continue
        step = _displacement(problem, unknowns, others)
        corrected = replace(problem, positions=problem.positions + np.where(others[:, None], step, 0.0))
        if (_explained(corrected, unknowns, tolerance) & others).sum() < max(_FEWEST, _EXPLAINED * others.sum()):
            continue
        off = _millimetres(-step)
        return f"{_which(problem, others)} the LED positions are off by ({off}) mm against the others."
    return ""


def _which(problem: CalibrationProblem, others: Mask) -> str:
    """Describe poses in words: from one on, up to one, or how many."""
    n, names = len(others), problem.pose_names
    after = np.array([others[k:].sum() + (~others[:k]).sum() for k in range(n + 1)])
    k = int(np.argmax(np.maximum(after, n - after)))
    if max(after[k], n - after[k]) < 0.9 * n:
        return f"In {int(others.sum())} of {n} poses, such as {names[int(np.argmax(others))]},"
    return f"From pose {names[k]} on" if after[k] > n - after[k] else f"Up to pose {names[k - 1]}"


def _displacement(problem: CalibrationProblem, unknowns: Unknowns, poses: Mask) -> Array:
    """Return the common LED displacement to bring some poses to the places seen by the cameras, shape (3,) [m]."""
    step = np.zeros(3)
    for _ in range(5):
        still = replace(unknowns, displacements=np.tile(step, (len(problem.positions), 1)))
        used = problem.detected & projectable(still, problem) & poses
        line = linearise(still, problem, ParameterLayout.of(problem), used)
        pull = np.swapaxes(line.by_point, 1, 2) @ np.linalg.inv(line.covariances)
        normal = (pull @ line.by_point).sum(axis=0) + 1e-9 * np.eye(3)
        step = np.linalg.solve(normal, (pull @ line.residuals[..., None]).sum(axis=0)[:, 0])
    return np.asarray(step)


def _explained(problem: CalibrationProblem, unknowns: Unknowns, tolerance: float) -> Mask:
    """Mark poses with every spot near the prediction by some cameras, shape (n,)."""
    distances = _distances(problem, unknowns)
    return np.asarray(problem.detected.any(axis=0) & (~problem.detected | (distances < tolerance)).all(axis=0))


def _fit(problem: CalibrationProblem, rounds: int = _ROUNDS, *, thoroughly: bool = False) -> _Fitted:
    """Return a robust fit, just precise enough to see whether a fit is possible, or the best that there is."""
    layout, stated = ParameterLayout.of(problem), not problem.noise_to_estimate
    try:
        if thoroughly:
            unknowns = robust_start(problem, layout)
        else:
            unknowns = robust_fit(start(problem, layout), problem, layout, problem.detected, rounds).unknowns
    except (DegenerateDataError, InconsistentDataError, np.linalg.LinAlgError):
        return _Fitted(None, np.inf, np.inf, np.inf, stated)
    extent = float(np.sqrt(problem.positions.var(axis=0).sum()))
    still = replace(unknowns, displacements=np.zeros_like(problem.positions))
    points = still.robot_positions(problem)
    lengths = np.linalg.norm(problem.spots - image(still, points), axis=2) / MEDIAN_LENGTH
    depths = np.einsum("cx,nx->cn", still.rotations[:, 2], points) + still.translations[:, 2, None]
    shares = lengths * depths / still.intrinsics[:, :1] / max(extent, 1e-300)
    seen = list(problem.detected)
    px, share = (max(_median(row[c]) for row, c in zip(values, seen, strict=True)) for values in (lengths, shares))
    median = max(_median(row[c]) for row, c in zip(_distances(problem, unknowns), seen, strict=True))
    return _Fitted(unknowns, float(np.sqrt(median / chi2_median(2))), px, share, stated)


def _median(values: Array) -> float:
    """Return the median; what is behind the camera is infinitely far off."""
    return float(np.median(np.where(np.isfinite(values), values, np.inf)))


def _distances(problem: CalibrationProblem, unknowns: Unknowns) -> Array:
    """Return the squared Mahalanobis length of each spot's residual, infinite behind the camera, shape (c, n)."""
    still = replace(unknowns, displacements=np.zeros_like(problem.positions))
    visible = problem.detected & projectable(still, problem)
    distances = spot_distances(linearise(still, problem, ParameterLayout.of(problem), visible))
    return np.where(visible, distances, np.inf)


def _of_camera(problem: CalibrationProblem, c: int) -> CalibrationProblem:
    """Return the observations of one camera as a problem."""
    return replace(
        problem,
        camera_names=problem.camera_names[c : c + 1],
        image_sizes=problem.image_sizes[c : c + 1],
        lens_models=problem.lens_models[c : c + 1],
        spots=problem.spots[c : c + 1],
        spot_covariances=problem.spot_covariances[c : c + 1],
        lengths=None,
    )
