"""Calibrations as plain values for JSON: the report, and the answer to a trial of a data set."""

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from im_calibration.errors import DegenerateDataError, InconsistentDataError
from im_calibration.estimation.unknowns import camera_parameters
from im_calibration.judgement.calibration import Calibration, CameraEstimate, TargetPlace
from im_calibration.judgement.checks import Checks
from im_calibration.judgement.expected import ImageError
from im_calibration.judgement.neighbours import Neighbours
from im_calibration.judgement.noise import Noise
from im_calibration.judgement.scale import Scale
from im_calibration.pipeline import calibrate
from im_calibration.problem.problem import CalibrationProblem


def report_of(calibration: Calibration, problem: CalibrationProblem) -> dict[str, Any]:
    """Return everything a user of the cameras needs to know; undefined numbers are null."""
    problem = problem.of_cameras([camera.name for camera in calibration.cameras])
    nominal = np.array(problem.led_offset_nominal)
    undetected = [
        {"pose": pose, "camera": camera, "reason": "The LED was not found."}
        for c, camera in enumerate(problem.camera_names)
        for pose, seen in zip(problem.pose_names, problem.detected[c], strict=True)
        if not seen and problem.placements is None
    ]
    deviations = dict(zip(calibration.parameter_names, numbers(calibration.standard_deviations), strict=True))
    return {
        "success": calibration.success,
        "message": calibration.message,
        "points_given": len(problem.pose_names),
        "points_used": calibration.points_used,
        "points_rejected": [
            {"pose": r.pose, "camera": r.camera or None, "reason": r.reason, "sigmas": number(r.sigmas)}
            for r in calibration.rejections
        ],
        "points_not_seen": undetected,
        "cameras": [_camera(*each) for each in zip(calibration.cameras, calibration.images, strict=True)],
        "led_offset_nominal_m": numbers(nominal),
        "led_offset_prior_sd_m": problem.led_offset_prior_sd,
        "led_offset_m": numbers(nominal + calibration.led_offset_error),
        "led_offset_error_m": numbers(calibration.led_offset_error),
        "led_offset_standard_deviation_m": [deviations.get(f"led_offset.{axis}", 0.0) for axis in "xyz"],
        "joint_offsets_rad": numbers(calibration.joint_offsets),
        "joint_offsets_standard_deviation_rad": [
            value for name, value in deviations.items() if name.startswith("joint_offset.")
        ],
        "chi2": number(calibration.chi2),
        "dof": calibration.dof,
        "chi2_per_dof": number(calibration.chi2_per_dof),
        "p_value": number(calibration.p_value),
        "verdicts": [
            {"kind": v.kind, "parameters": list(v.parameters), "reason": v.reason, "advice": v.advice}
            for v in (*calibration.verdicts, *calibration.left_out)
        ],
        "scale": None if calibration.scale is None else _plain(calibration.scale),
        "noise": _noise(calibration.noise),
        "arm_error_m": calibration.arm_error_m,
        "views": calibration.views,
        "target": None if calibration.target is None else _target(calibration.target),
        "neighbours": _plain(calibration.neighbours),
        "checks": _plain(calibration.checks),
        "expected_error": {
            "triangulation_mm": number(calibration.expected.triangulation_rms_mm),
            "reprojection_px": number(calibration.expected.reprojection_rms_px),
            "map": {
                "points_m": [numbers(point) for point in calibration.expected.points],
                "triangulation_mm": numbers(calibration.expected.triangulation_mm),
                "reprojection_px": numbers(calibration.expected.reprojection_px),
            },
            "workspace_low_m": list(problem.workspace.low),
            "workspace_high_m": list(problem.workspace.high),
        },
    }


def _target(target: TargetPlace) -> dict[str, Any]:
    return {
        "frame": target.frame,
        "transform": [numbers(row) for row in target.transform],
        "covariance": [numbers(row) for row in target.covariance],
    }


def _plain(fields: Scale | Neighbours | Checks) -> dict[str, Any]:
    return {name: number(value) for name, value in asdict(fields).items()}


def _noise(noise: Noise) -> dict[str, Any]:
    factors = {
        name: {"factor": number(factor.value), "low": number(factor.low), "high": number(factor.high)}
        for name, factor in (
            ("image", noise.factors.image),
            ("robot", noise.factors.robot),
            ("common", noise.factors.common),
        )
    }
    return {
        **factors,
        "separable": noise.factors.separable,
        "p_value": number(noise.factors.p_value),
        "estimated": list(noise.estimated),
        "scaled_by": {"image": noise.scale[0], "robot": noise.scale[1]},
        "sigma_image_px": number(noise.image_px * noise.scale[0]),
        "sigma_robot_m": number(noise.robot_m * noise.scale[1]),
        "remark": noise.remark,
    }


def _camera(camera: CameraEstimate, image: ImageError) -> dict[str, Any]:
    model = camera.model
    return {
        "name": camera.name,
        "width": model.width,
        "height": model.height,
        "K": [numbers(row) for row in model.K],
        "distortion_model": model.distortion_model,
        "D": numbers(model.D),
        "R_cam_base": [numbers(row) for row in model.R_cam_base],
        "t_cam_base_m": numbers(model.t_cam_base),
        "rms_px": number(camera.rms_px),
        "spots_used": camera.spots_used,
        "standard_deviations": dict(
            zip(camera_parameters(model.lens), numbers(camera.standard_deviations), strict=True)
        ),
        "covariance": [numbers(row) for row in camera.covariance],
        "image_error": {
            "u_px": numbers(image.u),
            "v_px": numbers(image.v),
            "expected_px": [numbers(row) for row in image.expected_px],
            "at_spots_px": number(image.at_spots_px),
            "holds_within_u_u_v_v_px": numbers(image.region),
        },
    }


def number(value: float) -> float | None:
    """Return a finite number, or None."""
    return float(value) if np.isfinite(value) else None


def numbers(values: ArrayLike) -> list[float | None]:
    """Return the numbers of a vector, None where not finite."""
    return [number(value) for value in np.asarray(values, dtype=float).ravel()]


def answer(problem: CalibrationProblem) -> dict[str, Any]:
    """Calibrate; where no estimate is possible there are no cameras, and the flag says why.

    Returns:
        Cameras, offsets and flags of the format, and what is known about them: message, verdicts with advice,
        outliers, covariance of all parameters, checks, and the errors to expect.

    >>> answer(problem.taking(np.arange(6)))["flags"]
    ['UNOBSERVABLE']
    """
    try:
        result = calibrate(problem)
    except (DegenerateDataError, InconsistentDataError) as error:
        flag = "UNOBSERVABLE" if isinstance(error, DegenerateDataError) else "MISFIT"
        parameters = list(error.parameters)
        verdict = {"kind": flag, "parameters": parameters, "reason": error.reason, "advice": error.advice}
        message = f"{flag}: {error.message}"
        return {"cameras": [], "chi2_per_dof": None, "flags": [flag], "message": message, "verdicts": [verdict]}
    report = report_of(result, problem)
    model = ("K", "distortion_model", "D", "R_cam_base", "t_cam_base_m")
    told: dict[str, Any] = {
        "cameras": [{key: camera[key] for key in model} for camera in report["cameras"]],
        "chi2_per_dof": number(result.chi2_per_dof),
        "p_value": number(result.p_value),
        "flags": sorted({verdict.kind for verdict in result.verdicts}, reverse=True),
        "message": result.message,
        "verdicts": report["verdicts"],
        "outlier": (problem.detected & ~result.used).astype(int).tolist(),
        "rejections": report["points_rejected"],
        "parameters": list(result.parameter_names),
        "standard_deviations": numbers(result.standard_deviations),
        "covariance": [numbers(row) for row in np.asarray(result.covariance)],
        **{
            key: report[key]
            for key in ("scale", "target", "noise", "arm_error_m", "neighbours", "checks", "expected_error")
        },
    }
    if problem.led_offset_prior_sd > 0.0:
        told["led_offset_error_m"] = numbers(result.led_offset_error)
    if len(result.joint_offsets):
        told["joint_offsets_rad"] = numbers(result.joint_offsets)
    return told
