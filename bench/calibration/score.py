"""Errors of many trials of one kind as ratios to the bound and to OpenCV, and how often intervals hold the truth."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bench.calibration.opencv import opencv_cameras
from bench.calibration.synthetic import Design, SyntheticScene, make_scene
from im_calibration.estimation.covariance import covariance_of
from im_calibration.estimation.residuals import linearise
from im_calibration.estimation.unknowns import ParameterLayout, Unknowns, intrinsics_of
from im_calibration.judgement.calibration import Calibration
from im_calibration.judgement.expected import expected_error
from im_calibration.pipeline import calibrate
from im_cell.calibration_error import CalibrationError, evaluate, rms
from im_cell.camera_model import CameraModel

Array = NDArray[np.float64]

_LOST = 1e3
"""Error [px, mm] that counts for a trial without an answer."""


def true_unknowns(scene: SyntheticScene) -> Unknowns:
    """The unknowns as they are, LED positions at those measured."""
    cameras, layout = scene.cameras, ParameterLayout.of(scene.problem)
    return Unknowns(
        tuple(c.lens for c in cameras),
        intrinsics_of(cameras),
        np.array([c.R_cam_base for c in cameras]),
        np.array([c.t_cam_base for c in cameras]),
        scene.led_offset_error if layout.led else np.zeros(3),
        scene.joint_offsets[: layout.joints],
        np.zeros_like(scene.problem.positions),
    )


def cramer_rao(scene: SyntheticScene) -> CalibrationError:
    """Bound of both errors over the workspace, from the inliers at the truth, with the priors the data set states."""
    problem, layout, truth = scene.problem, ParameterLayout.of(scene.problem), true_unknowns(scene)
    line = linearise(truth, problem, layout, problem.detected & ~scene.outliers)
    information = np.einsum("nia,nij,njb->ab", line.jacobians, np.linalg.inv(line.covariances), line.jacobians)
    stated = np.diag(layout.stated_precision)
    covariance = covariance_of(information + stated).matrix
    return expected_error(truth, covariance, problem.image_sizes, problem.workspace)


@dataclass(frozen=True)
class Score:
    """Ratios of RMS errors over trials: reprojection first, triangulation second (NaN for one camera).

    Attributes:
        to_bound: Over the Cramer-Rao bound of the inliers.
        to_opencv: Over the best that OpenCV reaches.
        coverage: Share of trials whose 95 % interval holds the truth, by parameter.
        verdicts: Trials that got a verdict.
    """

    to_bound: tuple[float, float]
    to_opencv: tuple[float, float]
    coverage: Array
    verdicts: int


def score(design: Design, seeds: Iterable[int]) -> Score:
    """Simulate and calibrate.

    Raises:
        DataError: A trial has no answer at all.
    """
    ours, bounds, inside, verdicts = [], [], [], 0
    plain: list[tuple[float, float]] = []
    trimmed: list[tuple[float, float]] = []
    for seed in seeds:
        scene = make_scene(design, seed)
        calibration = calibrate(scene.problem)
        verdicts += not calibration.success
        ours.append(errors(tuple(camera.model for camera in calibration.cameras), scene))
        bound = cramer_rao(scene)
        bounds.append((bound.reprojection_rms_px, bound.triangulation_rms_mm))
        for answers, trim in ((plain, False), (trimmed, True)):
            cameras = opencv_cameras(scene.problem, scene.cameras[0], trim=trim)
            answers.append(errors(cameras, scene))
        inside.append(np.abs(deviations(calibration, scene)) < 1.959964 * calibration.standard_deviations)
    own = _rms(ours)
    opencv = np.minimum(_rms(plain), _rms(trimmed))
    to_bound, to_opencv = own / _rms(bounds), own / opencv
    return Score(
        (float(to_bound[0]), float(to_bound[1])),
        (float(to_opencv[0]), float(to_opencv[1])),
        np.asarray(np.mean(inside, axis=0)),
        verdicts,
    )


def deviations(calibration: Calibration, scene: SyntheticScene) -> Array:
    """Estimate minus truth of each unknown, in the order of ``parameter_names``."""
    parts: list[Array] = []
    for estimate, true in zip(calibration.cameras, scene.cameras, strict=True):
        model = estimate.model
        turned = Rotation.from_matrix(model.R_cam_base @ true.R_cam_base.T).as_rotvec()
        matrix = model.K - true.K
        parts += [np.diag(matrix)[:2], matrix[:2, 2], (model.D - true.D)[: true.lens.estimated], turned]
        parts.append(model.t_cam_base - true.t_cam_base)
    if scene.problem.led_offset_prior_sd > 0.0:
        parts.append(calibration.led_offset_error - scene.led_offset_error)
    if len(calibration.joint_offsets):
        parts.append(calibration.joint_offsets - scene.joint_offsets)
    return np.concatenate(parts)


def errors(cameras: tuple[CameraModel, ...] | None, scene: SyntheticScene) -> tuple[float, float]:
    """RMS reprojection [px] and triangulation error [mm] over the workspace, bounded; None: the cameras are lost."""
    if cameras is None:
        return _LOST, _LOST
    try:
        found = evaluate(cameras, scene.cameras, scene.problem.workspace.grid())
    except np.linalg.LinAlgError:
        return _LOST, _LOST
    return min(found.reprojection_rms_px, _LOST), min(found.triangulation_rms_mm, _LOST)


def _rms(pairs: list[tuple[float, float]]) -> Array:
    values = np.array(pairs)
    return np.array([rms(values[:, 0]), rms(values[:, 1])])
