"""Summary of a calibration report for the terminal, in a few lines; the report's folder has the full report."""

from collections.abc import Mapping, Sequence
from typing import Any


def summary(report: Mapping[str, Any]) -> str:
    """Cameras, errors and time of a report.

    Args:
        report: Content of ``report.json``; ``truth_error`` is shown if it is there.
    """
    lines = [
        f"{'camera':<16}{'fx':>9}{'fy':>9}{'cx':>8}{'cy':>8}{'k1':>9}{'residuals':>12}",
        *(_camera_line(camera) for camera in report["cameras"]),
        "",
        f"points           {report['points_used']} used, {len(report['points_rejected'])} left out; "
        f"chi2/dof {_number(report['chi2_per_dof'], '.3f')}",
        f"light            {_millimetres(report['led_offset_m'])} mm from the wrist",
        error_lines(report),
    ]
    timing = report.get("timing", {})
    if timing.get("wall_s"):
        lines.append(
            f"time             {timing['wall_s']:.1f} s for {timing['simulated_s']:.1f} s of the cell "
            f"({timing['simulated_s'] / timing['wall_s']:.1f} times real time)"
        )
    return "\n".join(lines)


def error_lines(report: Mapping[str, Any]) -> str:
    """Return the expected error, and the true error if present."""
    lines = [f"expected error   {_errors(report['expected_error'])}"]
    if "truth_error" in report:
        lines.append(f"true error       {_errors(report['truth_error'])}")
    return "\n".join(lines)


def _camera_line(camera: Mapping[str, Any]) -> str:
    K, D = camera["K"], camera["D"]
    values = f"{K[0][0]:9.2f}{K[1][1]:9.2f}{K[0][2]:8.2f}{K[1][2]:8.2f}{D[0]:9.4f}"
    return f"{camera['name']:<16}{values}{_number(camera['rms_px'], '.3f'):>9} px"


def _errors(errors: Mapping[str, Any]) -> str:
    reprojection = _number(errors["reprojection_px"], ".3f")
    triangulation = errors["triangulation_mm"]  # one camera has none
    second = f", {triangulation:.3f} mm triangulation" if triangulation is not None else ""
    return f"{reprojection} px reprojection{second}, RMS over the workspace"


def _millimetres(vector: Sequence[float]) -> str:
    return "(" + ", ".join(f"{1e3 * value:.2f}" for value in vector) + ")"


def _number(value: float | None, style: str) -> str:
    return "-" if value is None else format(value, style)
