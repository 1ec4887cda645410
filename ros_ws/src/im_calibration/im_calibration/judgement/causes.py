"""Possible causes of data fitting no camera: mirrored, other axes, other poses, a moved robot.

Each cause is tried: the data are changed as if it were so, and a robust fit shows whether the typical spot is then
explained far better. What is named is a cause that explains the data, which is not to say that it is the only one.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from im_calibration.errors import DegenerateDataError, InconsistentDataError
from im_calibration.estimation.residuals import linearise, projectable
from im_calibration.estimation.solve import robust_fit, spot_distances
from im_calibration.estimation.start import start
from im_calibration.estimation.unknowns import ParameterLayout, Unknowns
from im_calibration.problem.problem import CalibrationProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MIRROR = np.diag([1.0, 1.0, -1.0])
_GROSS = 3.0  # times the stated noise: less is noise rather than nonsense
_BETTER = 3.0
_HARDLY_BETTER = 1.3  # where wrists still have the axes of before, a mirror alone does not yet make the LED fit
_WIDE_SHARE = 0.3  # of the extent of the positions: how far an LED may be from where it is said to be
_MANY = 25
_FAR_SIGMAS, _LARGEST_OFFSET_M = 5.0, 1.0
_EXPLAINED, _FEWEST, _GATE = 0.6, 6, 30.0
_ROUNDS = 6
_LARGEST_CELL_M = 50.0


def strange_units(problem: CalibrationProblem) -> str:
    """Return the sentence: positions are too far apart for metres; otherwise empty."""
    spread = np.median(np.linalg.norm(problem.positions - np.median(problem.positions, axis=0), axis=1))
    if spread <= _LARGEST_CELL_M:
        return ""
    return f"Half of the LED positions are {spread:.0f} m and more from their median: are they metres?"


def find_cause(problem: CalibrationProblem) -> str:
    """Return a sentence on the cause of data fitting no camera unchanged; empty if no cause is found.

    Args:
        problem: The observations, in the order in which they were made.
    """
    if sentence := strange_units(problem):
        return sentence
    unknowns = _fitted(problem)
    alone = [_of_camera(problem, c) for c in range(len(problem.camera_names))]
    typical = [_typical_of(each) for each in alone]
    bad = [c for c, value in enumerate(typical) if value > _GROSS]
    if bad:
        everyone = len(bad) == len(alone)
        names = ", ".join(problem.camera_names[c] for c in bad)
        mirrored = max(_typical_of(_with_axes(alone[c], _MIRROR)) / typical[c] for c in bad)
        if everyone and mirrored < 1.0 / _HARDLY_BETTER and (which := _axes_named(problem, -1.0)):
            return f"The positions are mirrored: {which} the spots fit."
        if mirrored < 1.0 / _BETTER:
            return _mirrored(names, everyone=everyone)
        for shift, where in ((1, "before"), (-1, "after")):
            if all(_typical_of(_shifted(alone[c], shift)) < typical[c] / _BETTER for c in bad):
                whose = "The spots" if everyone else f"The spots of {names}"
                return f"{whose} are those of the pose {where}: shifted by one they fit."
    whole = _typical(problem, unknowns)
    if whole > _GROSS and (sentence := _wrists(problem, whole) or _led_elsewhere(problem, whole)):
        return sentence
    if len(problem.positions) < _MANY:  # few poses with outliers can be bent to say so
        return ""
    return _moved(problem, unknowns) or (_led_beyond(problem, unknowns) if whole < _GROSS else "")


def _shifted(problem: CalibrationProblem, shift: int) -> CalibrationProblem:
    """Return the spots, paired with the positions of the poses ``shift`` places earlier."""
    late = problem.taking(np.roll(np.arange(len(problem.positions)), shift))
    return replace(late, spots=problem.spots, spot_covariances=problem.spot_covariances)


def _mirrored(names: str, *, everyone: bool) -> str:
    """Return the message for a mirror image of the positions, seen by some cameras or by all."""
    if not everyone:
        return f"The images of {names} are mirrored: with one coordinate reversed the spots fit."
    return "The positions are mirrored, or all images are: with one axis reversed, or two exchanged, the spots fit."


def _wrists(problem: CalibrationProblem, typical: float) -> str:
    """Describe wrist rotations not matching the positions; detectable only with an unknown LED offset."""
    if problem.led_offset_prior_sd == 0.0:
        return ""
    turned = replace(problem, wrist_rotations=np.swapaxes(problem.wrist_rotations, 1, 2))
    if _typical_of(turned) < typical / _BETTER:
        return "The wrist's rotations are the wrong way round: with their inverses (wrist -> base) the spots fit."
    which = _axes_named(problem, 1.0)
    return which and f"The positions have other axes than the wrist's rotations: {which} the spots fit."


def _axes_named(problem: CalibrationProblem, handedness: float) -> str:
    """Return the fitting change of axes, detectable only from wrist rotations; empty if not detectable."""
    if problem.led_offset_prior_sd == 0.0:
        return ""
    tried = []
    for name, axes in _axes(handedness):
        changed = replace(problem, positions=problem.positions @ axes.T, joint_offset_prior_sd=0.0)
        tried.append((_typical_of(changed), name))
    tried.sort()
    clear = tried[0][0] < _GROSS and tried[1][0] > _BETTER * tried[0][0]
    return tried[0][1] if clear else ""


def _axes(handedness: float) -> Iterator[tuple[str, Array]]:
    """Yield reversals and exchanges of axes with the given determinant."""
    unit, letters = np.eye(3), "xyz"
    if handedness < 0.0:
        for i, letter in enumerate(letters):
            yield f"with {letter} reversed", unit - 2.0 * np.outer(unit[i], unit[i])
        for order in ((1, 0, 2), (2, 1, 0), (0, 2, 1)):
            first, second = (letters[i] for i in range(3) if order[i] != i)
            yield f"with {first} and {second} exchanged", unit[list(order)]
        return
    for order in ((1, 2, 0), (2, 0, 1)):
        yield f"with x, y, z taken from {', '.join(letters[i] for i in order)}", unit[list(order)]
    for i in range(3):
        first, second = (letter for k, letter in enumerate(letters) if k != i)
        yield f"with {first} and {second} reversed", 2.0 * np.outer(unit[i], unit[i]) - unit


def _led_elsewhere(problem: CalibrationProblem, typical: float) -> str:
    """Describe an LED farther from the nominal place than stated."""
    turned = problem.wrist_rotations - problem.wrist_rotations.mean(axis=0)
    if np.abs(turned).max() < 0.1:
        return ""
    extent = float(np.std(problem.positions, axis=0).max())
    free = replace(problem, led_offset_prior_sd=max(_WIDE_SHARE * extent, problem.led_offset_prior_sd))
    unknowns = _fitted(free)
    if unknowns is None or _typical(free, unknowns) > typical / _BETTER:
        return ""
    return _led_at(problem, unknowns.led_offset)


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
        unknowns = _fitted(part)
        if unknowns is None:
            continue
        tolerance = _GATE * max(1.0, _typical(part, unknowns)) ** 2
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


def _typical_of(problem: CalibrationProblem) -> float:
    return _typical(problem, _fitted(problem))


def _typical(problem: CalibrationProblem, unknowns: Unknowns | None) -> float:
    """Return the residual of the median spot over the size explained by stated noise; infinite without a camera."""
    if unknowns is None:
        return float("inf")
    median = float(np.median(_distances(problem, unknowns)[problem.detected]))
    return float(np.sqrt(median / scipy.stats.chi2.median(2)))


def _distances(problem: CalibrationProblem, unknowns: Unknowns) -> Array:
    """Return the squared Mahalanobis length of each spot's residual, infinite behind the camera, shape (c, n)."""
    still = replace(unknowns, displacements=np.zeros_like(problem.positions))
    visible = problem.detected & projectable(still, problem)
    distances = spot_distances(linearise(still, problem, ParameterLayout.of(problem), visible))
    return np.where(visible, distances, np.inf)


def _fitted(problem: CalibrationProblem) -> Unknowns | None:
    """Return a robust fit, just precise enough to see whether a fit is possible; None if there is none."""
    layout = ParameterLayout.of(problem)
    try:
        return robust_fit(start(problem, layout), problem, layout, problem.detected, _ROUNDS).unknowns
    except (DegenerateDataError, InconsistentDataError, np.linalg.LinAlgError):
        return None


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


def _with_axes(problem: CalibrationProblem, axes: Array) -> CalibrationProblem:
    """Return the problem in a world of other axes; for left-handed axes, the LED offset is mirrored as well."""
    jacobians = problem.joint_jacobians
    return replace(
        problem,
        positions=problem.positions @ axes.T,
        position_covariances=axes @ problem.position_covariances @ axes.T,
        wrist_rotations=axes @ problem.wrist_rotations @ axes.T,
        joint_jacobians=None if jacobians is None else axes @ jacobians,
    )
