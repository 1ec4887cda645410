"""How wrong a calibration is, once it is done: its report against the truth of the simulated testbed."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from im_cell.calibration_error import evaluate
from im_cell.camera_model import CameraModel
from im_cell.robot.truth import CameraTruth, CellTruth
from im_cell.workspace import Workspace
from im_core.errors import DataError, NotFoundError
from im_core.files import write_whole


def truth_error(report: Mapping[str, Any], truth: CellTruth) -> dict[str, Any]:
    """Errors of the calibrated cameras over the workspace.

    Args:
        report: Content of ``report.json``.
        truth: The true cameras and lights.

    Returns:
        ``triangulation_mm`` and ``reprojection_px`` (RMS over the workspace, None where not defined), and
        ``led_offset_mm``, the length of the error of the light's offset.

    Raises:
        DataError: The report has no cameras, or one of them moves with the arm.
        NotFoundError: A camera of the report does not exist in truth.
    """
    if not report.get("success") or not report.get("cameras"):
        raise DataError(f"the report holds no calibration: {report.get('message', 'it is empty')}")
    estimated, true = [], []
    for camera in report["cameras"]:
        real = _true_camera(camera["name"], truth)
        true.append(_model(real.width, real.height, real.K, real.D, real.R_cam_base, real.t_cam_base_m))
        shape = (camera["K"], camera["D"], camera["R_cam_base"], camera["t_cam_base_m"])
        estimated.append(_model(real.width, real.height, *shape))
    expected = report["expected_error"]
    corners = expected.get("workspace_low_m"), expected.get("workspace_high_m")
    workspace = Workspace(*(tuple(corner) for corner in corners)) if all(corners) else Workspace()
    error = evaluate(estimated, true, workspace.grid())
    offsets = [np.subtract(report["led_offset_m"], led.offset_m) for led in truth.leds.values()]
    return {
        "triangulation_mm": _finite(error.triangulation_rms_mm),
        "reprojection_px": _finite(error.reprojection_rms_px),
        "led_offset_mm": 1e3 * min(float(np.linalg.norm(offset)) for offset in offsets),
    }


def add_to_report(path: Path, truth: CellTruth) -> dict[str, Any]:
    """Add ``truth_error`` to a report file, in one step.

    Returns:
        The report with it.

    Raises:
        DataError: The file is not a report of a calibration.
        NotFoundError: A camera of the report does not exist in truth.
    """
    try:
        report: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path} is not a report: {error}", file=str(path)) from error
    report["truth_error"] = truth_error(report, truth)
    write_whole(path, json.dumps(report, indent=2, allow_nan=False) + "\n")
    return report


def _true_camera(name: str, truth: CellTruth) -> CameraTruth:
    if name not in truth.cameras:
        raise NotFoundError(kind="camera", name=name, known=truth.cameras)
    camera = truth.cameras[name]
    if camera.parent != "world":
        raise DataError(
            f"camera '{name}' is fixed to {camera.parent} and moves; its error over the workspace is not defined"
        )
    return camera


def _model(width: int, height: int, K: Any, D: Any, R_cam_base: Any, t_cam_base: Any) -> CameraModel:
    return CameraModel(width, height, np.array(K), np.array(D), np.array(R_cam_base), np.array(t_cam_base))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
