"""Message of a calibration report, from the report as JSON: of the Service ``calibrate`` and of the command."""

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from im_msgs.msg import CalibrationReport, CameraCalibration, Rejection


def report_message(report: Mapping[str, Any], message: str, directory: str) -> CalibrationReport:
    """Return the message of a report.

    Args:
        report: Report of a calibration with an estimate, as written by ``im_calibration.report_of``.
        message: Outcome in a sentence or two.
        directory: Folder of plots and files; empty: none.
    """
    scale = report["scale"]
    expected = report["expected_error"]
    return CalibrationReport(
        success=report["success"],
        message=message,
        cameras=[_camera(camera) for camera in report["cameras"]],
        points_used=report["points_used"],
        points_rejected=[
            Rejection(pose=r["pose"], camera=r["camera"] or "", reason=r["reason"]) for r in report["points_rejected"]
        ],
        led_offset=report["led_offset_m"],
        chi2_per_dof=_number(report["chi2_per_dof"]),
        verdicts=["{kind}: {reason} {advice}".format(**verdict) for verdict in report["verdicts"]],
        expected_triangulation=_number(expected["triangulation_mm"]),
        expected_reprojection=_number(expected["reprojection_px"]),
        lengths_used=int(scale["lengths_used"]) if scale else 0,
        scale_error=_number(scale["error"]) if scale else math.nan,
        scale_sd=_number(scale["standard_deviation"]) if scale else math.nan,
        directory=directory,
        json=json.dumps(report),
    )


def _camera(camera: Mapping[str, Any]) -> CameraCalibration:
    covariance = np.array(camera["covariance"], dtype=float).ravel()
    return CameraCalibration(
        name=camera["name"],
        width=camera["width"],
        height=camera["height"],
        k=np.ravel(camera["K"]),
        d=camera["D"],
        r_cam_base=np.ravel(camera["R_cam_base"]),
        t_cam_base=camera["t_cam_base_m"],
        rms=_number(camera["rms_px"]),
        points=camera["spots_used"],
        covariance=covariance.tolist() if np.all(np.isfinite(covariance)) else [],
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else value
