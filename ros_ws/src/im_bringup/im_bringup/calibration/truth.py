"""True error of a finished calibration: report against the truth of the simulated testbed."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field, ValidationError

from im_cell.calibration_error import evaluate
from im_cell.camera_model import CameraModel
from im_cell.robot.parameters import Vector
from im_cell.robot.truth import CameraTruth, CellTruth, Matrix
from im_cell.workspace import Workspace
from im_core.config import Model, faults
from im_core.errors import DataError, NotFoundError
from im_core.files import FileError, write_whole
from im_core.text.jsontext import load_json


class _Section(Model):
    """Section of a report with only the fields read here; the report holds more."""

    model_config = ConfigDict(extra="ignore")


class _CalibratedCamera(_Section):
    name: str
    K: Matrix
    D: Annotated[tuple[float, ...], Field(min_length=5, max_length=14)]
    R_cam_base: Matrix
    t_cam_base_m: Vector


class _ExpectedError(_Section):
    workspace_low_m: Vector | None = None
    workspace_high_m: Vector | None = None


class _Calibration(_Section):
    cameras: Annotated[tuple[_CalibratedCamera, ...], Field(min_length=1)]
    led_offset_m: Vector
    expected_error: _ExpectedError


def truth_error(report: Mapping[str, Any], truth: CellTruth) -> dict[str, Any]:
    """Compute the errors of the calibrated cameras over the workspace.

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
    try:
        calibration = _Calibration.model_validate(report)
    except ValidationError as wrong:
        fault = faults(wrong, _Calibration)[0]
        raise DataError(f"the report holds no calibration: {fault.field}: {fault.sentence}") from wrong
    estimated, true = [], []
    for camera in calibration.cameras:
        real = _true_camera(camera.name, truth)
        true.append(_model(real.width, real.height, real))
        estimated.append(_model(real.width, real.height, camera))
    low, high = calibration.expected_error.workspace_low_m, calibration.expected_error.workspace_high_m
    workspace = Workspace(low, high) if low and high else Workspace()
    error = evaluate(estimated, true, workspace.grid())
    offsets = [np.subtract(calibration.led_offset_m, led.offset_m) for led in truth.leds.values()]
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
        report = load_json(path)
    except FileError as error:
        raise DataError(f"{path} is not a report: {error.message}", file=str(path)) from error
    if not isinstance(report, dict):
        raise DataError(f"{path} is not a report: it is not a JSON object", file=str(path))
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


def _model(width: int, height: int, camera: "_CalibratedCamera | CameraTruth") -> CameraModel:
    pose = np.array(camera.R_cam_base), np.array(camera.t_cam_base_m)
    return CameraModel(width, height, np.array(camera.K), np.array(camera.D), *pose)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
