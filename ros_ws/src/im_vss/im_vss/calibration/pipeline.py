"""The calibration from observations to verdicts, one step after the other."""

from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from im_core.camera_model import CameraModel
from im_vss.calibration.calibration import Calibration, CameraEstimate, Rejection
from im_vss.calibration.covariance import covariance_of
from im_vss.calibration.errors import InconsistentDataError
from im_vss.calibration.expected import expected_error
from im_vss.calibration.gates import Gated, fit_with_gates
from im_vss.calibration.problem import MINIMUM_SPOTS, CalibrationProblem
from im_vss.calibration.projection import project
from im_vss.calibration.residuals import projectable
from im_vss.calibration.solve import Fit, robust_cost, robust_fit
from im_vss.calibration.start import start
from im_vss.calibration.unknowns import PER_CAMERA, Layout, Unknowns
from im_vss.calibration.verdicts import judge

Array = NDArray[np.float64]

_RESTARTS = 1


def calibrate(problem: CalibrationProblem) -> Calibration:
    """Calibrate all cameras of a problem together.

    DLT and RANSAC start, robust fit, chi-square gates and maximum likelihood until stable, covariance, verdicts. The
    result does not depend on the order of the poses, and the same problem gives the same bits.

    Args:
        problem: The observations.

    Returns:
        The estimate with everything known about it; look at ``success`` and ``verdicts`` before using it.

    Raises:
        DegenerateDataError: There is no estimate at all: a camera with fewer than 7 spots, or positions on a line.
        InconsistentDataError: There is no estimate at all: spots that fit no camera.
    """
    order = _canonical_order(problem)
    sorted_problem = _reordered(problem, order)
    layout = Layout.of(problem)
    gated = fit_with_gates(_robust_start(sorted_problem, layout), sorted_problem, layout)
    if not np.isfinite(gated.fit.chi2):
        raise InconsistentDataError("No set of cameras explains the spots; check that they belong to these poses.")
    restore = np.argsort(order)
    gated = replace(gated, used=gated.used[:, restore], distances=gated.distances[:, restore])
    return _describe(problem, layout, gated)


def _robust_start(problem: CalibrationProblem, layout: Layout) -> Fit:
    """Robust fit from a linear start; with unknown offsets started again from those found, and the better one kept."""
    fits = [robust_fit(start(problem, layout), problem, layout, problem.detected)]
    if layout.led or layout.joints:
        for _ in range(_RESTARTS):
            again = start(problem, layout, fits[-1].unknowns)
            fits.append(robust_fit(again, problem, layout, problem.detected))
    best = min(fits, key=lambda fit: robust_cost(fit.unknowns, problem, layout))
    seen = problem.detected & projectable(best.unknowns, problem)
    for camera, spots in zip(problem.camera_names, seen.sum(axis=1), strict=True):
        if spots < MINIMUM_SPOTS:
            raise InconsistentDataError(
                f"No camera explains where {camera} saw the LED; check that the spots belong to these poses.",
                camera=camera,
            )
    return best


def _describe(problem: CalibrationProblem, layout: Layout, gated: Gated) -> Calibration:
    fit, used, unknowns = gated.fit, gated.used, gated.fit.unknowns
    covariance = covariance_of(fit.information)
    robot_positions = unknowns.robot_positions(problem)
    pixels, by_point, _ = project(unknowns.intrinsics, unknowns.rotations, unknowns.translations, robot_positions)
    residuals = problem.spots - pixels
    spread = by_point @ problem.position_covariances @ np.swapaxes(by_point, 2, 3) + problem.spot_covariances
    cameras = []
    for c, name in enumerate(problem.camera_names):
        block = layout.camera_slice(c)
        rms_px = float(np.sqrt((residuals[c][used[c]] ** 2).sum(axis=1).mean()))
        model = _camera_model(unknowns, c, problem.image_sizes[c])
        cameras.append(CameraEstimate(name, model, covariance.matrix[block, block], int(used[c].sum()), rms_px))
    dof = 2 * int(used.sum()) - PER_CAMERA * layout.cameras
    calibration = Calibration(
        cameras=tuple(cameras),
        led_offset_error=unknowns.led_offset,
        joint_offsets=unknowns.joint_offsets,
        parameter_names=layout.names(problem.camera_names),
        covariance=covariance.matrix,
        chi2=fit.chi2,
        dof=dof,
        p_value=float(scipy.stats.chi2.sf(fit.chi2, dof)) if dof > 0 else float("nan"),
        used=used,
        residuals=residuals,
        residual_covariances=spread,
        led_positions=robot_positions,
        rejections=_rejections(problem, gated),
        verdicts=(),
        expected=expected_error(unknowns, covariance.matrix, problem.image_sizes, problem.workspace),
    )
    return replace(calibration, verdicts=judge(calibration, problem, layout, covariance))


def _camera_model(unknowns: Unknowns, c: int, image_size: tuple[int, int]) -> CameraModel:
    fx, fy, cx, cy, *lens = unknowns.intrinsics[c]
    u, _, vt = np.linalg.svd(unknowns.rotations[c])
    return CameraModel(
        width=image_size[0],
        height=image_size[1],
        K=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        D=np.array([*lens, 0.0]),
        R_cam_base=u @ vt,
        t_cam_base=unknowns.translations[c],
    )


def _rejections(problem: CalibrationProblem, gated: Gated) -> tuple[Rejection, ...]:
    """One entry a pose if nothing of it counts, else one a spot."""
    rejections = []
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


def _canonical_order(problem: CalibrationProblem) -> NDArray[np.intp]:
    """Order of the poses by their data alone."""
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


def _reordered(problem: CalibrationProblem, order: NDArray[np.intp]) -> CalibrationProblem:
    jacobians = problem.joint_jacobians
    return replace(
        problem,
        positions=problem.positions[order],
        position_covariances=problem.position_covariances[order],
        wrist_rotations=problem.wrist_rotations[order],
        spots=problem.spots[:, order],
        spot_covariances=problem.spot_covariances[:, order],
        joint_jacobians=None if jacobians is None else jacobians[order],
        pose_names=tuple(problem.pose_names[i] for i in order),
    )
