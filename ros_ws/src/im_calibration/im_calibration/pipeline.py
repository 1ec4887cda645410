"""The calibration from observations to verdicts, one step after the other."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from im_calibration.errors import InconsistentDataError
from im_calibration.estimation.arm import Explanation, with_arm_error, with_usual_arm
from im_calibration.estimation.covariance import covariance_of
from im_calibration.estimation.gates import TRUSTED_SHARE, Gated
from im_calibration.estimation.noise import NoiseFactors, noise_factors
from im_calibration.estimation.projection import project
from im_calibration.estimation.search import REDUNDANT_SPOTS, best_explanation, first_explanation, plausible
from im_calibration.estimation.solve import Fit
from im_calibration.estimation.unknown_noise import find_noise
from im_calibration.estimation.unknowns import ParameterLayout, Unknowns
from im_calibration.judgement.agreement import CameraAgreement, camera_agreements
from im_calibration.judgement.calibration import Calibration, CameraEstimate, Rejection, TargetPlace, chance_of
from im_calibration.judgement.causes import find_cause, find_slip
from im_calibration.judgement.checks import Checks, check
from im_calibration.judgement.curvature import parameter_curvature
from im_calibration.judgement.expected import expected_error, image_error
from im_calibration.judgement.lenses import LensFault, lens_faults
from im_calibration.judgement.neighbours import Neighbours, compare_neighbours
from im_calibration.judgement.noise import UNLIKELY, Noise, noise_of
from im_calibration.judgement.scale import Scale, measure_scale
from im_calibration.judgement.verdicts import judge
from im_calibration.problem.problem import NOISE_SOURCES, CalibrationProblem
from im_cell.calibration_error import rms
from im_cell.camera_model import CameraModel
from im_cell.lens import PLUMB_BOB

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_RULED = 1.0 - 1e-4
_NO_NOISE_SHARE = 0.005
# From an origin that far rotations and translations of a camera look alike: a nearer one, a multiple away, serves.
_FAR_M = 10.0
_HOPELESS = 9.0  # times the stated variance, for the typical of many poses: no other start makes that right


def calibrate(problem: CalibrationProblem) -> Calibration:
    """Calibrate all cameras of a problem together.

    DLT and RANSAC start, robust fit, chi-square gates and maximum likelihood until stable, covariance, verdicts. The
    result does not depend on the order of the poses, nor on how far the origin of the world is, and the same problem
    gives the same bits.

    Returns:
        The estimate with everything known about it; look at ``success`` and ``verdicts`` before using it.

    Raises:
        DegenerateDataError: There is no estimate at all: a camera with fewer than 7 spots, or positions on a line.
        InconsistentDataError: There is no estimate at all: spots that fit no camera, or noise stated so small that
            double precision cannot tell it from zero.

    >>> [verdict.reason for verdict in calibrate(problem.taking(np.arange(8))).verdicts]
    ['ceiling has 8 spots that agree, too few to check 14 parameters.']
    """
    far = _FAR_M * np.round(problem.positions.mean(axis=0) / _FAR_M)
    try:
        if not far.any():
            return _calibrate(problem)
        return _calibrate(problem.moved(-far)).moved(far)
    except np.linalg.LinAlgError as error:
        raise InconsistentDataError(
            "The stated noise is too small beside the other numbers to compute with."
        ) from error


def _calibrate(stated: CalibrationProblem) -> Calibration:
    order = _canonical_order(stated)
    layout = ParameterLayout.of(stated)
    cause, found = "", None
    if stated.noise_to_estimate:
        found = find_noise(stated.taking(order), layout, stated.noise_to_estimate)
        explanation = found.explanation
        cause = find_cause(stated) if _nonsense(explanation) else find_slip(stated)
    else:
        ordered = with_usual_arm(stated.taking(order))
        explanation = Explanation(ordered, of_all := ParameterLayout.of(ordered), first_explanation(ordered, of_all))
        bent = with_arm_error(explanation.gated, explanation.problem)
        if bent.problem.arm_error is not None and not _nonsense(bent):
            explanation = bent
        else:
            explanation = bent if bent.problem.arm_error is None else explanation
            cause = find_cause(stated) if _nonsense(explanation) else ""
            hopeless = explanation.gated.scale > _HOPELESS and len(stated.positions) >= REDUNDANT_SPOTS
            if not cause and not hopeless:
                gated = best_explanation(explanation.problem, explanation.layout, explanation.gated)
                explanation = bent if gated is explanation.gated else with_arm_error(gated, explanation.problem)
    sorted_problem, layout, gated = explanation.problem, explanation.layout, explanation.gated
    if not np.isfinite(gated.fit.chi2):
        raise InconsistentDataError("No set of cameras explains the spots.")
    factors = _factors(gated, sorted_problem, layout, cause) if found is None else found.factors
    checks = check(gated, sorted_problem, layout)
    neighbours = compare_neighbours(gated.fit.linearisation, gated.used, sorted_problem.positions)
    agreements = camera_agreements(gated.fit.linearisation, gated.used, layout)
    chi2_per_dof = gated.fit.chi2 / max(1, _freedom(gated.fit, gated.used, layout))
    faults = () if cause else lens_faults(gated, sorted_problem, layout, chi2_per_dof)  # wrong data fit no lens either
    restore = np.argsort(order)
    problem = sorted_problem.taking(restore)
    gated = replace(gated, used=gated.used[:, restore], distances=gated.distances[:, restore])
    noise = noise_of(stated, gated.used, factors, (1.0, 1.0) if found is None else found.scale)
    return _describe(problem, layout, gated, checks, agreements, noise, neighbours, faults, cause)


def _nonsense(found: Explanation) -> bool:
    """Check whether a search for the cause of bad data is worthwhile."""
    gated, problem, layout = found.gated, found.problem, found.layout
    return not plausible(gated, problem, layout) or _beyond_noise(gated, problem)


def _beyond_noise(gated: Gated, problem: CalibrationProblem) -> bool:
    """Check whether the typical residual is too large a part of the image for the noise of any camera."""
    residuals = np.linalg.norm(gated.fit.linearisation.residuals.reshape(-1, 2), axis=1)
    width = min(width for width, _ in problem.image_sizes)
    return bool(np.median(residuals[residuals > 0.0]) > _NO_NOISE_SHARE * width)


def _factors(gated: Gated, problem: CalibrationProblem, layout: ParameterLayout, cause: str) -> NoiseFactors:
    """Return noise factors from residuals; if stated noise is too small, gates cut residuals off and must widen."""
    dof = _freedom(gated.fit, gated.used, layout)
    few = bool(np.any(gated.used.sum(axis=1) < TRUSTED_SHARE * problem.detected.sum(axis=1)))
    chi2 = gated.fit.chi2 - layout.prior(gated.fit.unknowns).lens_chi2
    if not cause and not _beyond_noise(gated, problem) and (few or chance_of(chi2, dof) < UNLIKELY):
        return find_noise(problem, layout, NOISE_SOURCES).factors
    return noise_factors(gated.fit.unknowns, problem, layout, gated.used)


def _freedom(fit: Fit, used: Mask, layout: ParameterLayout) -> int:
    """Return the degrees of freedom of chi-square; a lens prior adds none, but a share of the knowledge counts."""
    prior = layout.prior(fit.unknowns)
    from_prior = float((covariance_of(fit.information).matrix * prior.lens_information).sum())
    return round(2 * int(used.sum()) - layout.free_size + from_prior)


def _describe(
    problem: CalibrationProblem,
    layout: ParameterLayout,
    gated: Gated,
    checks: Checks,
    agreements: tuple[CameraAgreement, ...],
    noise: Noise,
    neighbours: Neighbours,
    faults: tuple[LensFault, ...],
    cause: str,
) -> Calibration:
    fit, used, unknowns = gated.fit, gated.used, gated.fit.unknowns
    covariance = covariance_of(fit.information)
    robot_positions = unknowns.robot_positions(problem)
    pixels, by_point, _ = project(unknowns, robot_positions)
    residuals = problem.spots - pixels
    spread = by_point @ problem.position_covariances @ np.swapaxes(by_point, 2, 3) + problem.spot_covariances
    cameras = []
    for c, name in enumerate(problem.camera_names):
        block = layout.camera_slice(c)
        rms_px = rms(np.linalg.norm(residuals[c][used[c]], axis=1))
        model = _camera_model(unknowns, c, problem.image_sizes[c])
        known, seen = covariance.matrix[block, block], used[c]
        weights = np.linalg.inv(spread[c][seen])
        curvature = parameter_curvature(unknowns, layout, c, known, robot_positions[seen], weights)
        cameras.append(CameraEstimate(name, model, known, int(seen.sum()), rms_px, curvature))
    prior = layout.prior(unknowns)
    dof = _freedom(fit, used, layout)
    calibration = Calibration(
        cameras=tuple(cameras),
        led_offset_error=unknowns.led_offset,
        joint_offsets=unknowns.joint_offsets,
        parameter_names=layout.names(problem.camera_names),
        covariance=covariance.matrix[: layout.shared_slice.start, : layout.shared_slice.start],
        chi2=fit.chi2,
        dof=dof,
        p_value=chance_of(fit.chi2, dof),
        lens_prior_chi2=prior.lens_chi2,
        used=used,
        residuals=residuals,
        residual_covariances=spread,
        led_positions=robot_positions,
        rejections=_rejections(problem, gated),
        verdicts=(),
        views=0 if problem.placements is None else _views(problem, used),
        target=_target_place(problem, unknowns, covariance.matrix[layout.placed_slice, layout.placed_slice]),
        arm_error_m=0.0 if problem.arm_error is None else problem.arm_error.standard_deviation,
        expected=expected_error(unknowns, covariance.matrix, problem.image_sizes, problem.workspace),
        images=tuple(
            image_error(unknowns, camera.covariance, c, camera.model, robot_positions[used[c]])
            for c, camera in enumerate(cameras)
        ),
        checks=checks,
        scale=_scale(problem, unknowns, covariance.matrix, used),
        noise=noise,
        neighbours=neighbours,
        cause=cause,
    )
    # Terms of a larger lens model make up for each other; a hundredth of the prior keeps them from nowhere.
    ruled = 1.0 if all(lens is PLUMB_BOB for lens in layout.lenses) else _RULED
    by_data = covariance_of(fit.information - ruled * prior.lens_information)
    return replace(calibration, verdicts=judge(calibration, problem, layout, by_data, agreements, faults))


def _views(problem: CalibrationProblem, used: Mask) -> int:
    """Return how many views of a target count."""
    assert problem.placements is not None
    labels = problem.readings or problem.placements.of.astype(str)
    return len(np.unique(np.array(labels)[used.any(axis=0)]))


def _target_place(problem: CalibrationProblem, unknowns: Unknowns, covariance: Array) -> TargetPlace | None:
    if (placements := problem.placements) is None or placements.held is not None:
        return None
    moved = np.vstack((unknowns.placements[0], (0.0, 0.0, 0.0, 1.0)))
    return TargetPlace("base" if placements.camera_moves else "link", moved @ placements.places[0], covariance)


def _scale(problem: CalibrationProblem, unknowns: Unknowns, covariance: Array, used: Mask) -> Scale | None:
    if problem.lengths is None:
        return None
    middle = np.median(unknowns.robot_positions(problem)[used.any(axis=0)], axis=0)
    return measure_scale(unknowns, covariance, problem.lengths, middle)


def _camera_model(unknowns: Unknowns, c: int, image_size: tuple[int, int]) -> CameraModel:
    fx, fy, cx, cy = unknowns.intrinsics[c, :4]
    u, _, vt = np.linalg.svd(unknowns.rotations[c])
    return CameraModel(
        width=image_size[0],
        height=image_size[1],
        K=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        D=unknowns.coefficients(c),
        R_cam_base=u @ vt,
        t_cam_base=unknowns.translations[c],
        distortion_model=unknowns.lenses[c].name,
    )


def _rejections(problem: CalibrationProblem, gated: Gated) -> tuple[Rejection, ...]:
    """Return one entry per pose if no spot of the pose counts, else one per spot; one per camera's view of a target."""
    if problem.placements is not None:
        return _rejected_points(problem, gated)
    rejections = list[Rejection]()
    for i, pose in enumerate(problem.pose_names):
        out = np.flatnonzero(problem.detected[:, i] & ~gated.used[:, i])
        sigmas = np.sqrt(gated.distances[:, i])
        if len(out) > 1 and len(out) == problem.detected[:, i].sum():
            worst = float(sigmas[out].max())
            reason = f"The robot's position disagrees with all cameras by {worst:.1f} sigma: stale joint reading?"
            rejections.append(Rejection(pose, "", reason, worst))
            continue
        for c in out:
            reason = f"The spot is {sigmas[c]:.1f} sigma from where the other poses predict it: wrong light?"
            rejections.append(Rejection(pose, problem.camera_names[c], reason, float(sigmas[c])))
    return tuple(rejections)


def _rejected_points(problem: CalibrationProblem, gated: Gated) -> tuple[Rejection, ...]:
    views = np.array([name.rpartition(" point ")[0] for name in problem.pose_names])
    rejections = []
    for view in dict.fromkeys(views.tolist()):
        for c, camera in enumerate(problem.camera_names):
            seen = (views == view) & problem.detected[c]
            out = seen & ~gated.used[c]
            if not out.any():
                continue
            worst = float(np.sqrt(gated.distances[c, out].max()))
            where = f"{out.sum()} of {seen.sum()} points are up to {worst:.1f} sigma from where the others predict them"
            cause = (
                "stale pose of the robot" if problem.readings and out.sum() == seen.sum() else "hidden, or bent target"
            )
            rejections.append(Rejection(view, camera, f"{where}: {cause}?", worst))
    return tuple(rejections)


def _canonical_order(problem: CalibrationProblem) -> NDArray[np.intp]:
    """Return the order of the poses by data alone."""
    n = len(problem.positions)
    keys = np.column_stack(
        (
            problem.positions,
            problem.wrist_rotations.reshape(n, 9),
            problem.position_covariances.reshape(n, 9),
            np.swapaxes(problem.spots, 0, 1).reshape(n, -1),
            np.swapaxes(problem.spot_covariances, 0, 1).reshape(n, -1),
        )
    )
    return np.lexsort(np.nan_to_num(keys, nan=-1.0).T[::-1])
