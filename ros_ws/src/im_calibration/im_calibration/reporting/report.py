"""Calibrations as plain values for JSON: the report, and the answer to a trial of a data set."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from im_calibration.errors import DegenerateDataError, InconsistentDataError
from im_calibration.estimation.unknowns import camera_parameters
from im_calibration.judgement.calibration import Calibration, CameraEstimate
from im_calibration.judgement.checks import Checks
from im_calibration.judgement.neighbours import Neighbours
from im_calibration.judgement.noise import Noise
from im_calibration.judgement.scale import Scale
from im_calibration.pipeline import calibrate
from im_calibration.problem.problem import CalibrationProblem
from im_cell.lens import lens_of


def report_of(calibration: Calibration, problem: CalibrationProblem) -> dict[str, Any]:
    """Return everything a user of the cameras needs to know; undefined numbers are null.

    Args:
        calibration: The result.
        problem: What it was made from.
    """
    problem = problem.of_cameras([camera.name for camera in calibration.cameras])
    nominal = np.array(problem.led_offset_nominal)
    undetected = [
        {"pose": pose, "camera": camera, "reason": "The LED was not found."}
        for c, camera in enumerate(problem.camera_names)
        for pose, seen in zip(problem.pose_names, problem.detected[c], strict=True)
        if not seen
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
        "cameras": [_camera(camera) for camera in calibration.cameras],
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


def _camera(camera: CameraEstimate) -> dict[str, Any]:
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
    }


def number(value: float) -> float | None:
    """Return a finite number, or None."""
    return float(value) if np.isfinite(value) else None


def numbers(values: ArrayLike) -> list[float | None]:
    """Return the numbers of a vector, None where not finite."""
    return [number(value) for value in np.asarray(values, dtype=float).ravel()]


def summary(report: Mapping[str, Any]) -> str:
    """The report as text for people.

    Args:
        report: As made by :func:`report_of`.

    >>> summary(report_of(calibration, problem)).splitlines()[5].split(" (")[0]
    'poses used          40 of 40'
    """
    lines = ["Camera calibration", "==================", "", report["message"], ""]
    lines += [
        f"poses used          {report['points_used']} of {report['points_given']}"
        f" ({len(report['points_not_seen'])} spots not found, {len(report['points_rejected'])} observations rejected)",
        f"chi2 / dof          {_text(report['chi2_per_dof'], '.3f')}"
        f" (dof {report['dof']}, p {_text(report['p_value'], '.2g')})",
        f"expected error      {_expected(report['expected_error'])}, RMS over the workspace",
        f"held-out poses      {_found(report['checks'], 'held_out')}",
        f"far half            {_found(report['checks'], 'far_half')}",
        f"neighbours          {_neighbours_text(report['neighbours'])}",
        f"noise               {_noise_text(report['noise'])}",
        f"error of the arm    {1e3 * report['arm_error_m']:.3g} mm in each coordinate",
        "LED offset [mm]     " + _vector(report["led_offset_m"], report["led_offset_standard_deviation_m"], 1e3),
    ]
    if report["scale"]:
        scale = report["scale"]
        lines.append(
            f"robot's scale       {100.0 * scale['error']:+.3f} ± {100.0 * scale['standard_deviation']:.3f} % by "
            f"{scale['lengths_used']:.0f} of {scale['lengths_given']:.0f} known lengths"
        )
    if report["joint_offsets_rad"]:
        values = _vector(report["joint_offsets_rad"], report["joint_offsets_standard_deviation_rad"], 1e3)
        lines.append(f"joint offsets [mrad] {values}")
    for camera in report["cameras"]:
        lines += ["", *_camera_lines(camera)]
    for title, key in (("Verdicts", "verdicts"), ("Rejected", "points_rejected")):
        if report[key]:
            lines += ["", title]
        for entry in report[key]:
            if key == "verdicts":
                lines.append(f"  {entry['kind']}: {entry['reason']} {entry['advice']}")
            else:
                where = f"pose {entry['pose']}" + (f", {entry['camera']}" if entry["camera"] else "")
                lines.append(f"  {where}: {entry['reason']}")
    return "\n".join(lines) + "\n"


def _camera_lines(camera: Mapping[str, Any]) -> list[str]:
    sd = camera["standard_deviations"]
    K, D = camera["K"], camera["D"]
    centre = -np.array(camera["R_cam_base"]).T @ camera["t_cam_base_m"]
    rows = [
        ("fx, fy [px]", (K[0][0], K[1][1]), ("fx", "fy"), 1.0),
        ("cx, cy [px]", (K[0][2], K[1][2]), ("cx", "cy"), 1.0),
        *_lens_rows(camera["distortion_model"], D),
        ("t_cam_base [mm]", camera["t_cam_base_m"], ("tx", "ty", "tz"), 1e3),
    ]
    lines = [f"{camera['name']} ({camera['spots_used']} spots, residuals {_text(camera['rms_px'], '.3f')} px RMS)"]
    for label, values, names, scale in rows:
        lines.append(f"  {label:<17} {_vector(values, [sd[name] for name in names], scale)}")
    spread = ", ".join(_text(sd[name] and 1e3 * sd[name], ".2f") for name in ("rx", "ry", "rz"))
    lines.append(f"  rotation [mrad]   known to {spread}")
    lines.append(f"  stands at [m]     {', '.join(f'{value:.3f}' for value in centre)}")
    return lines


def _lens_rows(model: str, D: Sequence[float]) -> list[tuple[str, list[float], tuple[str, ...], float]]:
    """Return rows of the estimated coefficients: radial ones two by two, and the decentering ones."""
    lens = lens_of(model)
    values = dict(zip(lens.coefficients[: lens.estimated], D, strict=False))
    pairs = {"k1, k2": 1.0, "p1, p2": 1e3, "k3, k4": 1.0, "k5, k6": 1.0}
    rows = []
    for label, scale in pairs.items():
        names = tuple(label.split(", "))
        if names[0] in values:
            rows.append((label + " [1e-3]" * (scale != 1.0), [values[name] for name in names], names, scale))
    return rows


def _expected(errors: dict[str, Any]) -> str:
    """The errors to expect; one camera has none of triangulation."""
    reprojection = f"{_text(errors['reprojection_px'], '.3f')} px reprojection"
    triangulation = errors["triangulation_mm"]
    return reprojection if triangulation is None else f"{reprojection}, {triangulation:.2f} mm triangulation"


def _found(checks: Mapping[str, float | None], name: str) -> str:
    """Return the text of a check beside the expected value."""
    return f"{_text(checks[f'{name}_px'], '.3f')} px, {_text(checks[f'{name}_expected_px'], '.3f')} px expected"


def _neighbours_text(neighbours: Mapping[str, float | None]) -> str:
    found, limit = (_text(neighbours[name], ".2f") for name in ("correlation", "limit"))
    return f"correlation of residuals {found}, of noise below {limit}"


def _noise_text(noise: Mapping[str, Any]) -> str:
    """Describe the noise used by the estimate, and compare the stated noise with the residuals."""
    used = f"{noise['sigma_image_px']:.3g} px, {1e3 * noise['sigma_robot_m']:.3g} mm"
    source = f"estimated ({', '.join(noise['estimated'])})" if noise["estimated"] else "as stated"
    factors = ", ".join(
        f"{name} {_text(noise[name]['low'], '.2f')} to {_text(noise[name]['high'], '.2f')}"
        for name in ("image", "robot", "common")
    )
    return f"{used}, {source}; by the residuals, times the stated one: {factors}"


def _text(value: float | None, form: str) -> str:
    return "unknown" if value is None else format(value, form)


def _vector(values: Sequence[float | None], deviations: Sequence[float | None], scale: float) -> str:
    """Format values with standard deviations, to two digits of the deviations."""
    parts = []
    for value, deviation in zip(values, deviations, strict=True):
        if value is None or deviation is None:
            parts.append(f"{_text(value, 'g')} ± unknown")
            continue
        size = deviation * abs(scale)
        digits = min(6, max(0, 1 - math.floor(math.log10(size)))) if size > 0.0 else 3
        parts.append(f"{value * scale:.{digits}f} ± {size:.{digits}f}")
    return ", ".join(parts)


def answer(problem: CalibrationProblem) -> dict[str, Any]:
    """Calibrate; where no estimate is possible there are no cameras, and the flag says why.

    Args:
        problem: The trial.

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
        **{key: report[key] for key in ("scale", "noise", "arm_error_m", "neighbours", "checks", "expected_error")},
    }
    if problem.led_offset_prior_sd > 0.0:
        told["led_offset_error_m"] = numbers(result.led_offset_error)
    if len(result.joint_offsets):
        told["joint_offsets_rad"] = numbers(result.joint_offsets)
    return told
