"""Verdicts: unknowns not determined by the data, and residuals not explained by the stated noise."""

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.chi_squared import chi2_limit
from im_calibration.estimation.covariance import Covariance
from im_calibration.estimation.gates import FALSE_ALARM, TRUSTED_SHARE
from im_calibration.estimation.start import FLAT, core_extent, robust_extent
from im_calibration.estimation.unknowns import (
    CENTRE_PRIOR_SD,
    LENS_RADIUS,
    ParameterLayout,
    camera_parameters,
    lens_reach,
)
from im_calibration.judgement.agreement import CameraAgreement
from im_calibration.judgement.calibration import Calibration, Verdict
from im_calibration.judgement.causes import LARGEST_ARM_SHARE, LARGEST_SPOT_PX, MEDIAN_LENGTH, strange_units
from im_calibration.judgement.lenses import LensFault
from im_calibration.judgement.scale import Scale
from im_calibration.problem.problem import CalibrationProblem
from im_cell.camera_model import CameraModel
from im_cell.lens import PLUMB_BOB

Array = NDArray[np.float64]

UNOBSERVABLE, MISFIT = "UNOBSERVABLE", "MISFIT"

_SPARE_SPOTS = 2
_SAME_WRIST = 0.05
_UNLIKELY = 1e-3
_FEWEST_MOVED, _MOVED_SHARE = 6, 0.1
_DOUBTED_CHANCE, _DOUBTED_SHARE = 0.05, 0.7  # poor residuals and many rejections together are a misfit as well
_NEAR_SIGMAS = 7.0  # rejections barely beyond the gates are rarely gross outliers; with some, less bad residuals do
_NEAR_CHANCES = ((6, 0.1), (3, 0.02), (0, _UNLIKELY))
_FAR_RATIO = 2.0
_NEAR_LARGEST, _LARGEST_ERROR_M = 0.9, 0.02
_LARGEST_READING_M = 3e-3  # of a robot with a target: its smooth error is noise there, and its space is not known
_FAR_CENTRE, _NEAR_CENTRE = 2.0, 0.5  # standard deviations of the principal point from the middle of its image
_RIM_PX = 1.5  # from the centre of the outermost pixel
_FOCAL_LIMIT = 0.07
_TURN_LIMIT = 0.15
_CENTRE_LIMIT = 0.15
_LENS_LIMITS = {1: 0.05, 2: 1.0, 4: 12.0, 6: 40.0, 8: 100.0}
_LENS_EFFECT = 0.36


def judge(
    calibration: Calibration,
    problem: CalibrationProblem,
    layout: ParameterLayout,
    covariance: Covariance,
    agreements: tuple[CameraAgreement, ...],
    faults: tuple[LensFault, ...],
) -> tuple[Verdict, ...]:
    """Return the reasons not to trust an estimate; none for a good one.

    Args:
        calibration: The estimate, without verdicts.
        problem: What it was made from.
        layout: Places of the unknowns.
        covariance: Covariance of the unknowns by the data alone, without the priors of the lens.
        agreements: How well each camera agrees with the robot and the other cameras.
        faults: Lens models that leave patterns in the residuals.
    """
    verdicts = []
    misfit = _misfit(calibration, problem, agreements)
    for c in range(layout.cameras):
        doubtful = misfit is not None
        verdict = _few_spots(calibration, problem, c, doubtful) or _flat(calibration, problem, c, doubtful)
        if verdict is None and misfit is None:  # the standard deviations of a misfit mean nothing
            verdict = _unknown(calibration, layout, covariance, c)
        if verdict:
            verdicts.append(verdict)
    if layout.led and (verdict := _led_offset(calibration, problem, layout)):
        verdicts.append(verdict)
    if misfit:
        verdicts.append(misfit)
    verdicts += [
        _wrong_lens(calibration, layout, fault) for fault in faults if fault.explains or not (misfit or verdicts)
    ]
    if not verdicts and (verdict := _far_half(calibration)):
        verdicts.append(verdict)
    if calibration.scale and (verdict := _wrong_scale(calibration.scale)):
        verdicts.append(verdict)
    return tuple(verdicts)


def _few_spots(calibration: Calibration, problem: CalibrationProblem, c: int, misfit: bool) -> Verdict | None:
    """Too few spots; where the noise is not as stated, gates leave few of many, and more poses would not help."""
    camera = calibration.cameras[c]
    enough, fewest = problem.detected[c].sum() if misfit else camera.spots_used, problem.fewest_spots[c] + _SPARE_SPOTS
    if enough >= fewest:
        return None
    names = camera_parameters(camera.model.lens)
    return Verdict(
        UNOBSERVABLE,
        _camera_names(camera.name, names),
        f"{camera.name} has {camera.spots_used} spots that agree, too few to check {len(names)} parameters.",
        f"Give at least {fewest}, better 30, poses in its view.",
    )


def _flat(calibration: Calibration, problem: CalibrationProblem, c: int, misfit: bool) -> Verdict | None:
    """Report LED positions in a plane: focal length and distance, principal point and tilt cannot be told apart.

    Which spots a misfit believes means little, so that there most of the positions decide.
    """
    camera = calibration.cameras[c]
    extent = robust_extent(calibration.led_positions[calibration.used[c]])
    if extent[2] >= FLAT * extent[0] and misfit:
        extent = core_extent(problem.positions[problem.detected[c]])
    if extent[2] >= FLAT * extent[0] or problem.placements is not None:  # turned targets tell it all the same
        return None
    return Verdict(
        UNOBSERVABLE,
        _camera_names(camera.name, ("fx", "fy", "cx", "cy", "rx", "ry", "tx", "ty", "tz")),
        f"The LED positions seen by {camera.name} lie in a plane (within {1e3 * extent[2]:.1f} mm, over "
        f"{1e3 * extent[0]:.0f} mm), so that focal length and distance cannot be told apart.",
        "Vary the height of the poses by at least a fifth of the width of the workspace.",
    )


def _unknown(calibration: Calibration, layout: ParameterLayout, covariance: Covariance, c: int) -> Verdict | None:
    """Report parameters with a standard deviation beyond the tolerance of any use of a camera."""
    camera, lens = calibration.cameras[c], calibration.cameras[c].model.lens
    focal, size = float(camera.model.K[0, 0]), (camera.model.width, camera.model.height)
    reach, parameters = lens_reach(focal, size), camera_parameters(lens)
    # Of a long lens, focal length and distance differ by as little in the image as its field is deep.
    limits = dict.fromkeys(("fx", "fy"), _FOCAL_LIMIT * focal / reach) | dict.fromkeys(("rx", "ry", "rz"), _TURN_LIMIT)
    limits |= dict.fromkeys(("cx", "cy"), _CENTRE_LIMIT * size[0] / reach)
    limits |= {
        name: _LENS_LIMITS[power] * reach**-power
        for name, power in zip(lens.coefficients[: lens.estimated], lens.powers, strict=False)
    }
    block = layout.camera_slice(c)
    deviations = dict(zip(parameters, covariance.standard_deviations[block], strict=True))
    lost = dict(zip(parameters, covariance.null[block], strict=True))
    names = tuple(name for name in parameters if lost[name] or deviations[name] > limits.get(name, np.inf))
    if lens is not PLUMB_BOB and _lens_effect(camera.model, covariance.matrix[block, block], reach) < _LENS_EFFECT:
        # Terms of such lenses make up for each other: what counts is what they do together.
        names = tuple(name for name in names if name not in lens.coefficients)
    if not names:
        return None
    figures = ", ".join(f"{name} ± {deviations[name]:.2g}" for name in names)
    return Verdict(
        UNOBSERVABLE,
        _camera_names(camera.name, names),
        f"The poses hardly determine {figures} of {camera.name}.",
        "Spread the poses over the whole view of the camera, near and far, or reduce the noise.",
    )


def _lens_effect(model: CameraModel, covariance: Array, reach: float) -> float:
    """Return the standard deviation of points placed by the lens at the edge of the judged area, over the radius."""
    radius, lens = LENS_RADIUS * reach, model.lens
    edge = radius * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    by_lens = lens.by_coefficients(edge, model.D, (1.0, 1.0))[..., : lens.estimated]
    terms = slice(4, 4 + lens.estimated)
    spread = by_lens @ covariance[terms, terms] @ np.swapaxes(by_lens, 1, 2)
    return float(np.sqrt(np.linalg.eigvalsh(spread).max())) / radius


def _led_offset(calibration: Calibration, problem: CalibrationProblem, layout: ParameterLayout) -> Verdict | None:
    """Report an LED offset shifting all positions alike because the wrist hardly turns."""
    used = calibration.used.any(axis=0)
    rotations = problem.wrist_rotations[used]
    turned = rotations - rotations.mean(axis=0)
    variation = np.linalg.eigvalsh((np.swapaxes(turned, 1, 2) @ turned).mean(axis=0))
    precision = problem.led_offset_prior_sd**-2
    block = calibration.covariance[layout.led_slice, layout.led_slice]
    values, vectors = np.linalg.eigh(np.linalg.inv(block) - precision * np.eye(3))
    if variation[0] >= _SAME_WRIST or values[0] >= precision:
        return None
    poor = vectors[:, values < precision]
    shares = np.linalg.norm(poor, axis=1)
    axes = tuple(f"led_offset.{axis}" for axis, share in zip("xyz", shares, strict=True) if share > 0.3)
    cameras = tuple(name for c in problem.camera_names for name in _camera_names(c, ("tx", "ty", "tz")))
    return Verdict(
        UNOBSERVABLE,
        axes + cameras,
        "The wrist hardly turns between the poses, so that an error of the LED's offset cannot be told from a shift of "
        f"the cameras ({', '.join(axes)} known by the prior of {1e3 * problem.led_offset_prior_sd:.1f} mm only).",
        "Vary the wrist's orientation about at least two axes by 30 degrees or more, or measure the offset.",
    )


def _misfit(
    calibration: Calibration, problem: CalibrationProblem, agreements: tuple[CameraAgreement, ...]
) -> Verdict | None:
    """Report residuals not explained by the stated noise."""
    detected, used = problem.detected.sum(axis=1), calibration.used.sum(axis=1)
    near = sum(rejection.sigmas < _NEAR_SIGMAS for rejection in calibration.rejections)
    chance = calibration.p_value_of_data
    noisy = chance < next(limit for fewest, limit in _NEAR_CHANCES if near >= fewest)
    trusted = _DOUBTED_SHARE if chance < _DOUBTED_CHANCE else TRUSTED_SHARE
    contradictory = np.flatnonzero(used < trusted * detected)
    moved = [c for c in range(len(calibration.cameras)) if _moved_alike(calibration, problem, c)]
    outside = _outside_image(calibration, problem)
    bent = _beyond_arms(calibration, problem) or _beyond_spots_and_arms(calibration, problem)
    if not (len(contradictory) or noisy or moved or outside or bent or calibration.cause):
        return None
    reasons = [text for text in (calibration.cause or strange_units(problem), bent) if text]
    if noisy:
        reasons.append(
            f"The residuals are {np.sqrt(calibration.chi2_per_dof):.1f} times as large as the stated noise explains "
            f"(chi2/dof {calibration.chi2_per_dof:.2f}, p {chance:.1g}); {_worst_camera(calibration, agreements)}."
        )
    if noisy and chance >= _UNLIKELY:
        reasons.append(f"{near} rejections are within {_NEAR_SIGMAS:.0f} sigma, nearer than gross outliers would be.")
    reasons += [
        f"Only {used[c]} of {detected[c]} spots of {problem.camera_names[c]} agree with each other."
        for c in contradictory
    ]
    reasons += [_moved_alike(calibration, problem, c) for c in moved]
    reasons += outside
    return Verdict(
        MISFIT,
        (),
        " ".join(reasons),
        "Check that cameras and robot base did not move, that joint readings belong to the exposures, the robot's "
        "kinematic parameters, the stated noise, and the units and axes of the data [m, px].",
    )


def _far_half(calibration: Calibration) -> Verdict | None:
    """Report a half of the space that the other half predicts far worse than expected."""
    found, expected = calibration.checks.far_half_px, calibration.checks.far_half_expected_px
    if not (calibration.checks.far_half_p_value < _UNLIKELY and found > _FAR_RATIO * expected):
        return None
    return Verdict(
        MISFIT,
        (),
        f"Poses of one half of the space predict those of the other to {found:.2g} px, where {expected:.2g} px are to "
        f"be expected (p {calibration.checks.far_half_p_value:.1g}).",
        "Check the robot's kinematic parameters, and what is before the lens; use the cameras near the poses only.",
    )


def _wrong_lens(calibration: Calibration, layout: ParameterLayout, fault: LensFault) -> Verdict:
    """Report a lens model with too few terms, and the model to use instead."""
    name, lens = calibration.cameras[fault.camera].name, layout.lenses[fault.camera]
    pattern = f"its residuals depend on {fault.against} (p {fault.chance:.1g})" if fault.chance < _UNLIKELY else ""
    why = ", and ".join(text for text in (pattern, calibration.neighbours.clause) if text)
    reason = f"The lens model {fault.model} does not fit {name}" + f": {why}" * bool(why)
    advice = "No lens model known here does better: check positions, robot kinematics, and what is before the lens."
    if fault.better:
        before, after = fault.held_out_px
        reason += f"; {fault.better} predicts poses from the others to {after:.2g} px instead of {before:.2g} px"
        advice = f"Calibrate {name} as {fault.better} (--lens-model, or distortion_model in the data set)."
    parameters = _camera_names(name, lens.coefficients[: lens.estimated])
    return Verdict(MISFIT, parameters, f"{reason}.", advice, fault.better)


def _outside_image(calibration: Calibration, problem: CalibrationProblem) -> list[str]:
    """Return cameras with a wrong image size: spots outside agree, most lie there, or the sides are exchanged."""
    strange = []
    for c, (name, size) in enumerate(zip(problem.camera_names, problem.image_sizes, strict=True)):
        outside = _outside(problem.spots[c], size)
        if not (outside & calibration.used[c]).any() and 2 * outside.sum() <= problem.detected[c].sum():
            strange += _exchanged(calibration.cameras[c].model, name)
            continue
        text = f"{outside.sum()} of {problem.detected[c].sum()} spots of {name} are not in its image of "
        turned = not _outside(problem.spots[c], size[::-1]).any()
        advice = ": with width and height exchanged they are" * turned
        strange.append(f"{text}{size[0]} x {size[1]} px{advice}.")
    return strange


def _exchanged(model: CameraModel, name: str) -> list[str]:
    """Return a sentence on a principal point that is usual only in an image of exchanged width and height, if it is."""
    size, focal = (model.width, model.height), float(model.K[0, 0])
    deviation = CENTRE_PRIOR_SD * max(size) / lens_reach(focal, size)
    off, then = (float(np.abs(model.K[:2, 2] - (np.array(sides) - 1.0) / 2.0).max()) for sides in (size, size[::-1]))
    if off < _FAR_CENTRE * deviation or then > _NEAR_CENTRE * deviation:
        return []
    return [
        f"The principal point of {name} is {off:.0f} px from the middle of its image of {size[0]} x {size[1]} px: with "
        f"width and height exchanged it is {then:.0f} px from it."
    ]


def _outside(spots: Array, size: tuple[int, ...]) -> NDArray[np.bool_]:
    """Mark the spots, shape (n, 2) [px], more than a pixel outside of an image."""
    return np.asarray(np.any((spots < -_RIM_PX) | (spots > np.array(size) - 1.0 + _RIM_PX), axis=1))


def _beyond_arms(calibration: Calibration, problem: CalibrationProblem) -> str:
    """Report a smooth error as large as that of no arm; empty if it is smaller."""
    largest_m = problem.largest_arm_error.standard_deviation
    if calibration.arm_error_m < min(_NEAR_LARGEST * largest_m, _LARGEST_ERROR_M):
        return ""
    return (
        f"The positions are off by {1e3 * calibration.arm_error_m:.1f} mm or more, neighbouring ones alike, which is "
        "more than the error of an arm over such a space."
    )


def _beyond_spots_and_arms(calibration: Calibration, problem: CalibrationProblem) -> str:
    """Report estimated noise that neither spots nor an arm have; empty if they may, or the noise is stated."""
    if not problem.noise_to_estimate:
        return ""
    largest_m = LARGEST_ARM_SHARE * float(np.sqrt(problem.positions.var(axis=0).sum()))
    if problem.placements is not None:
        largest_m = max(largest_m, _LARGEST_READING_M)
    least_m = calibration.noise.factors.robot.low * calibration.noise.robot_m
    if least_m > largest_m:
        return (
            f"The robot's positions scatter by {1e3 * least_m:.1f} mm or more: no arm repeats a place so badly, so "
            "that something else is wrong."
        )
    for camera, residuals, used in zip(calibration.cameras, calibration.residuals, calibration.used, strict=True):
        depths = calibration.led_positions[used] @ camera.model.R_cam_base[2] + camera.model.t_cam_base[2]
        lengths = np.linalg.norm(residuals[used], axis=1) / MEDIAN_LENGTH
        off_px, off_m = float(np.median(lengths)), float(np.median(lengths * depths)) / float(camera.model.K[0, 0])
        if off_px > LARGEST_SPOT_PX and off_m > largest_m:
            return (
                f"The spots of {camera.name} are off by {off_px:.1f} px in each coordinate, {1e3 * off_m:.1f} mm at "
                "the light: neither spots nor an arm have such a noise, so that something else is wrong."
            )
    return ""


def _moved_alike(calibration: Calibration, problem: CalibrationProblem, c: int) -> str:
    """Report rejected spots all shifted alike: not outliers, but a moved camera; empty if not alike.

    A spot counts where the common shift decides: with it the spot is off by more than noise, without it it is not.
    """
    rejected = problem.detected[c] & ~calibration.used[c]
    residuals, spread = calibration.residuals[c][rejected], calibration.residual_covariances[c][rejected]
    if len(residuals) < _FEWEST_MOVED:
        return ""
    shift = np.median(residuals, axis=0)
    gate = chi2_limit(FALSE_ALARM, 2)
    alike = (_squared(residuals, spread) > gate) & (_squared(residuals - shift, spread) < gate)
    enough = max(_FEWEST_MOVED, TRUSTED_SHARE * len(residuals), _MOVED_SHARE * problem.detected[c].sum())
    if alike.sum() < enough:
        return ""
    return (
        f"{int(alike.sum())} of {len(residuals)} rejected spots of {problem.camera_names[c]} lie off by the same "
        f"({shift[0]:.1f}, {shift[1]:.1f}) px, as if it had moved."
    )


def _squared(errors: Array, covariances: Array) -> Array:
    """Squared Mahalanobis lengths, shape (m,), of errors, shape (m, 2)."""
    return np.asarray((errors * np.linalg.solve(covariances, errors[..., None])[..., 0]).sum(axis=1))


def _wrong_scale(scale: Scale) -> Verdict | None:
    """Report known lengths differing from the robot's, or from one another."""
    if scale.agreement < _UNLIKELY:
        return Verdict(
            MISFIT,
            ("robot.scale",),
            f"The {scale.lengths_used} known lengths contradict each other (p {scale.agreement:.1g}).",
            "Check that each length is of the two LEDs that were seen, and its stated uncertainty.",
        )
    if scale.p_value > _UNLIKELY:
        return None
    return Verdict(
        MISFIT,
        ("robot.scale",),
        f"Known lengths are {1.0 + scale.error:.5f} ± {scale.standard_deviation:.5f} times as long as in the robot's "
        "metres, which no residual can show.",
        "Correct the robot's link lengths and calibrate again; t_cam_base times this factor gives cameras in true "
        "metres, if all links are wrong alike.",
    )


def _worst_camera(calibration: Calibration, agreements: tuple[CameraAgreement, ...]) -> str:
    """Return the camera with the least likely spots, given the spots of the others."""
    worst = min(range(len(agreements)), key=lambda c: agreements[c].log_chance)
    given = " given what the others saw" if len(agreements) > 1 else ""
    return f"{calibration.cameras[worst].name} is worst with chi2/dof {agreements[worst].chi2_per_dof:.2f}{given}"


def _camera_names(camera: str, names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{camera}.{name}" for name in names)
