"""Report of a calibration of cameras as the fields of its message."""

import json
import math
from collections.abc import Mapping
from typing import Any

from im_core.errors import DataError


def report_fields(report: Mapping[str, Any]) -> dict[str, object]:
    """Return the fields of ``im_msgs/msg/CalibrationReport``, except the folder; undefined numbers are NaN.

    Args:
        report: Content of ``report.json``.

    Raises:
        DataError: A part is missing, or of another kind.
    """
    try:
        scale = report["scale"] or {"lengths_used": 0, "error": None, "standard_deviation": None}
        expected = report["expected_error"]
        return {
            "success": report["success"],
            "message": report["message"],
            "cameras": [_camera(camera) for camera in report["cameras"]],
            "points_used": report["points_used"],
            "points_rejected": [
                {"pose": each["pose"], "camera": each["camera"] or "", "reason": each["reason"]}
                for each in report["points_rejected"]
            ],
            "led_offset": report["led_offset_m"],
            "chi2_per_dof": _number(report["chi2_per_dof"]),
            "verdicts": [f"{each['kind']}: {each['reason']} {each['advice']}" for each in report["verdicts"]],
            "expected_triangulation": _number(expected["triangulation_mm"]),
            "expected_reprojection": _number(expected["reprojection_px"]),
            "lengths_used": int(scale["lengths_used"]),
            "scale_error": _number(scale["error"]),
            "scale_sd": _number(scale["standard_deviation"]),
            "json": json.dumps(report),
        }
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"the report of the calibration is not whole: {error!r}") from error


def _camera(camera: Mapping[str, Any]) -> dict[str, object]:
    covariance = [number for row in camera["covariance"] for number in row]
    return {
        "name": camera["name"],
        "width": camera["width"],
        "height": camera["height"],
        "k": [number for row in camera["K"] for number in row],
        "d": camera["D"],
        "r_cam_base": [number for row in camera["R_cam_base"] for number in row],
        "t_cam_base": camera["t_cam_base_m"],
        "rms": _number(camera["rms_px"]),
        "points": camera["spots_used"],
        "covariance": [] if None in covariance else covariance,
    }


def _number(value: float | None) -> float:
    return math.nan if value is None else value
