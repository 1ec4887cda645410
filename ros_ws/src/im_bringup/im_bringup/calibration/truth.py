"""True error of a finished calibration: report against the truth of the simulated testbed; places of free bodies."""

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, ValidationError

from im_cell.calibration_error import evaluate
from im_cell.camera_model import CameraModel
from im_cell.robot import Cell
from im_cell.robot.parameters import Vector
from im_cell.robot.truth import CameraTruth, CellTruth, Matrix, errors_of, tool_errors
from im_cell.rotations import cross_matrix, matrix_of_vector
from im_cell.workspace import Workspace, box_around
from im_core.config import Model, faults
from im_core.errors import DataError, NotFoundError
from im_core.files import FileError, write_whole
from im_core.names import CELL
from im_core.text.jsontext import load_json

Array = NDArray[np.float64]
_Read = TypeVar("_Read", bound=Model)
_Place = Annotated[float, Field(ge=-1e7, le=1e7)]


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


class _TargetPlace(_Section):
    transform: Annotated[tuple[tuple[float, float, float, float], ...], Field(min_length=4, max_length=4)]


class _Calibration(_Section):
    cameras: Annotated[tuple[_CalibratedCamera, ...], Field(min_length=1)]
    light: str
    led_offset_m: Vector
    expected_error: _ExpectedError
    target: _TargetPlace | None = None


class _Positions(_Section):
    x_base_m: Annotated[tuple[tuple[_Place, _Place, _Place], ...], Field(min_length=1)]


_Derivatives = tuple[tuple[tuple[Annotated[float, Field(ge=-1.0, le=1.0)], ...], ...], ...]


class _Observations(_Section):
    J_arm: _Derivatives
    trials: Annotated[tuple[_Positions, ...], Field(min_length=1)]


class _Robot(_Section):
    poses: Annotated[tuple[tuple[tuple[_Place, ...], ...], ...], Field(min_length=1)]
    J_arm: _Derivatives


class _Views(_Section):
    points_m: Annotated[tuple[Vector, ...], Field(min_length=1)]
    robot: _Robot


class _TargetObservations(_Section):
    target: _Views


def require_cell(truth: CellTruth, cell: Cell) -> None:
    """Refuse the truth of another cell.

    Raises:
        DataError: It has a joint, light or camera that the cell has not.
    """
    known = {*cell.joint_names, *cell.light_names, *cell.cameras}
    if others := [name for name in (*truth.joints, *truth.leds, *truth.cameras) if name not in known]:
        raise DataError(f"the cell has not what the testbed has, {', '.join(others)}: {CELL} names that of the machine")


def truth_error(
    report: Mapping[str, Any], observations: Mapping[str, Any], truth: CellTruth, cell: Cell
) -> dict[str, Any]:
    """Compute the errors of the calibrated cameras over the workspace.

    The frame of the cameras is the one that the readings of the arm have as a whole: where the true arm is off by a
    shift and a turn common to all positions, so are the true cameras.

    Args:
        report: Content of ``report.json``.
        observations: Content of ``observations.json``.
        truth: The true arms, cameras and lights.
        cell: The cell as drawn.

    Returns:
        ``triangulation_mm`` and ``reprojection_px`` (RMS over the workspace, None where not defined), and
        ``led_offset_mm``, the length of the error of the light's offset; None where it was not the target.

    Raises:
        DataError: The report has no cameras, or one of them moves with the arm; or the observations are malformed.
        NotFoundError: A camera or the light of the report does not exist in truth.
    """
    if not report.get("success") or not report.get("cameras"):
        raise DataError(f"the report holds no calibration: {report.get('message', 'it is empty')}")
    calibration = _read(_Calibration, report, "calibration")
    if calibration.light not in truth.leds:
        raise NotFoundError(kind="light", name=calibration.light, known=truth.leds)
    errors = errors_of(cell, cell.devices("light")[calibration.light], truth.joints)
    if calibration.target is None:
        seen = _read(_Observations, observations, "observations")
        positions = np.array(seen.trials[0].x_base_m)
        moved = _derivatives(seen.J_arm, (len(positions), 3, len(errors))) @ errors
    else:
        views = _read(_TargetObservations, observations, "observations").target
        positions, moved = _carried(views, np.array(calibration.target.transform), errors)
    turn, shift = _common_motion(positions, moved)
    estimated, true = [], []
    for camera in calibration.cameras:
        real = _true_camera(camera.name, truth)
        model = _model(real.width, real.height, real)
        R, t = model.R_cam_base @ turn, model.R_cam_base @ shift + model.t_cam_base
        true.append(replace(model, R_cam_base=R, t_cam_base=t))
        estimated.append(_model(real.width, real.height, camera))
    low, high = calibration.expected_error.workspace_low_m, calibration.expected_error.workspace_high_m
    workspace = Workspace(low, high) if low and high else box_around(positions)
    error = evaluate(estimated, true, workspace.grid())
    offset = np.subtract(calibration.led_offset_m, truth.leds[calibration.light].offset_m)
    by_light = calibration.target is None
    return {
        "triangulation_mm": _finite(error.triangulation_rms_mm),
        "reprojection_px": _finite(error.reprojection_rms_px),
        "led_offset_mm": 1e3 * float(np.linalg.norm(offset)) if by_light else None,
    }


def _derivatives(given: _Derivatives, shape: tuple[int, int, int]) -> Array:
    try:
        return np.array(given).reshape(shape)
    except ValueError as wrong:
        wanted = " x ".join(map(str, shape))
        raise DataError(f"J_arm of the observations is not {wanted} numbers, as positions and arm need") from wrong


def _carried(views: _Views, place: Array, errors: Array) -> tuple[Array, Array]:
    """Return positions of the points of a target on the wrist, and the shifts by the true arm, (n, 3) both."""
    poses = np.array(views.robot.poses)
    points = np.array(views.points_m) @ place[:3, :3].T + place[:3, 3]
    arms = np.einsum("kij,pj->kpi", poses[:, :3, :3], points)
    shifts, turns = np.split(_derivatives(views.robot.J_arm, (len(poses), 6, len(errors))) @ errors, 2, axis=1)
    moved = shifts[:, None] + np.cross(turns[:, None], arms)
    return (arms + poses[:, None, :3, 3]).reshape(-1, 3), moved.reshape(-1, 3)


def _common_motion(positions: Array, moved: Array) -> tuple[Array, Array]:
    """Return turn and shift nearest to small motions of positions, shapes (3, 3) [-] and (3,) [m].

    Args:
        positions: Shape (n, 3) [m].
        moved: Shape (n, 3) [m].
    """
    turned = np.stack([-cross_matrix(place) for place in positions])
    rigid = np.concatenate((turned, np.tile(np.eye(3), (len(positions), 1, 1))), axis=2).reshape(-1, 6)
    found = np.asarray(np.linalg.lstsq(rigid, moved.ravel())[0], dtype=float)
    return matrix_of_vector(found[:3]), found[3:]


def arms_off(truth: CellTruth, cell: Cell) -> str:
    """Describe the errors of the tools of all arms over the reach."""
    off = {name: 1e3 * tool_errors(cell, name, truth.joints, np.random.default_rng(0)) for name in cell.groups}
    told = [f"{name}: {np.sqrt(np.mean(mm**2)):.2f} mm RMS, {mm.max():.2f} mm at most" for name, mm in off.items()]
    return "off the drawing over the reach, the tool of\n" + "\n".join(told)


def add_to_report(path: Path, truth: CellTruth, cell: Cell) -> dict[str, Any]:
    """Add ``truth_error`` to a report file, beside the observations, in one step.

    Returns:
        The report with it.

    Raises:
        DataError: The file is not a report of a calibration, or has no observations beside it.
        NotFoundError: A camera or the light of the report does not exist in truth.
    """
    report, observations = _object(path, "a report"), _object(path.with_name("observations.json"), "observations")
    report["truth_error"] = truth_error(report, observations, truth, cell)
    write_whole(path, json.dumps(report, indent=2, allow_nan=False) + "\n")
    return report


def _object(path: Path, kind: str) -> dict[str, Any]:
    try:
        content = load_json(path)
    except FileError as error:
        raise DataError(f"{path} is not {kind}: {error.message}", file=str(path)) from error
    if not isinstance(content, dict):
        raise DataError(f"{path} is not {kind}: it is not a JSON object", file=str(path))
    return content


def _read(model: type[_Read], content: Mapping[str, Any], kind: str) -> _Read:
    try:
        return model.model_validate(content)
    except ValidationError as wrong:
        fault = faults(wrong, model)[0]
        raise DataError(f"the report holds no {kind}: {fault.field}: {fault.sentence}") from wrong


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


def place_of(name: str, truth: CellTruth) -> str:
    """Describe where a free body stands.

    Raises:
        NotFoundError: There is none of the name.
    """
    if name not in truth.objects:
        raise NotFoundError(kind="object", name=name, known=truth.objects)
    x, y, z, qx, qy, qz, qw = truth.objects[name]
    tilt = math.degrees(2.0 * math.asin(min(1.0, math.hypot(qx, qy))))
    yaw = math.degrees(2.0 * math.atan2(qz, qw))
    return f"{name} at ({x:.4f}, {y:.4f}, {z:.4f}) m, turned by {yaw:.1f} and tilted by {tilt:.1f} degrees"
