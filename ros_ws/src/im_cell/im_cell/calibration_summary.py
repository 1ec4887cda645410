"""Report of a calibration of cameras as text for people: whole, ``summary.txt``, and in a few lines."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from im_cell.lens import lens_of
from im_core.errors import DataError


def summary(report: Mapping[str, Any]) -> str:
    """Return the report as text for people.

    Args:
        report: Content of ``report.json``, of the solver or of the command.

    Raises:
        DataError: A part is missing, or of another kind.
    """
    try:
        return "\n".join(_lines(report)) + "\n"
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"the report of the calibration is not whole: {error!r}") from error


def brief_summary(report: Mapping[str, Any]) -> str:
    """Return cameras, errors and time of a report in a few lines, for a terminal.

    Args:
        report: Content of ``report.json``; ``truth_error`` is shown if it is there.
    """
    lines = [
        f"{'camera':<16}{'fx':>9}{'fy':>9}{'cx':>8}{'cy':>8}{'k1':>9}{'residuals':>12}",
        *(_brief_camera(camera) for camera in report["cameras"]),
        "",
        f"points           {report['points_used']} used, {len(report['points_rejected'])} left out; "
        f"chi2/dof {_text(report['chi2_per_dof'], '.3f')}",
        *_place_line(report),
        error_lines(report),
    ]
    timing = report.get("timing", {})
    if timing.get("wall_s"):
        lines.append(
            f"time             {timing['wall_s']:.1f} s for {timing['simulated_s']:.1f} s of the cell "
            f"({timing['simulated_s'] / timing['wall_s']:.1f} times real time)"
        )
    return "\n".join(lines)


def _place_line(report: Mapping[str, Any]) -> list[str]:
    """Return where light or target are, in a line; of a target without a robot there is nothing to tell."""
    target = report.get("target")
    if not target and report.get("views"):
        return []
    place = [row[3] for row in target["transform"][:3]] if target else report["led_offset_m"]
    values = ", ".join(f"{1e3 * value:.2f}" for value in place)
    return [
        f"target           ({values}) mm in the {target['frame']}"
        if target
        else f"light            ({values}) mm from the wrist"
    ]


def error_lines(report: Mapping[str, Any]) -> str:
    """Return the expected error of a report, and the true error if present."""
    lines = [f"expected error   {_errors(report['expected_error'])}"]
    if "truth_error" in report:
        lines.append(f"true error       {_errors(report['truth_error'])}")
    return "\n".join(lines)


def _brief_camera(camera: Mapping[str, Any]) -> str:
    K, D = camera["K"], camera["D"]
    values = f"{K[0][0]:9.2f}{K[1][1]:9.2f}{K[0][2]:8.2f}{K[1][2]:8.2f}{D[0]:9.4f}"
    return f"{camera['name']:<16}{values}{_text(camera['rms_px'], '.3f'):>9} px"


def _lines(report: Mapping[str, Any]) -> list[str]:
    lines = ["Camera calibration", "==================", "", report["message"], ""]
    lines += [
        _used_line(report),
        f"chi2 / dof          {_text(report['chi2_per_dof'], '.3f')}"
        f" (dof {report['dof']}, p {_text(report['p_value'], '.2g')})",
        f"expected error      {_errors(report['expected_error'])}",
        f"held-out poses      {_found(report['checks'], 'held_out')}",
        f"far half            {_found(report['checks'], 'far_half')}",
        f"neighbours          {_neighbours_text(report['neighbours'])}",
        f"noise               {_noise_text(report['noise'])}",
        f"error of the arm    {1e3 * report['arm_error_m']:.3g} mm in each coordinate",
    ]
    if target := report.get("target"):
        place = [row[3] for row in target["transform"][:3]]
        deviations = [float(target["covariance"][k][k]) ** 0.5 for k in (3, 4, 5)]
        lines.append(f"target [mm]         {_vector(place, deviations, 1e3)} in the {target['frame']}")
    elif not report.get("views"):
        offset = _vector(report["led_offset_m"], report["led_offset_standard_deviation_m"], 1e3)
        lines.append(f"LED offset [mm]     {offset}")
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
    return lines


def _used_line(report: Mapping[str, Any]) -> str:
    rejected = f"{len(report['points_rejected'])} observations rejected"
    if report.get("views") or report.get("target"):
        return f"points used         {report['points_used']} of {report['points_given']} ({rejected})"
    given, lost = report.get("poses", report["points_given"]), len(report["points_not_seen"])
    return f"poses used          {report['points_used']} of {given} ({lost} spots not found, {rejected})"


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


def _errors(errors: Mapping[str, Any]) -> str:
    """Format errors of images and points; one camera has none of triangulation."""
    triangulation = errors["triangulation_mm"]
    second = f", {triangulation:.3f} mm triangulation" if triangulation is not None else ""
    return f"{_text(errors['reprojection_px'], '.3f')} px reprojection{second}, RMS over the workspace"


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
