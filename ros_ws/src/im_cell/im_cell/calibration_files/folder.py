"""Folder of calibrations, checked against the cell of the calibrations."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from im_cell.calibration_files.covariance import COVARIANCE, read_covariance
from im_cell.calibration_files.extrinsics import EXTRINSICS, FRAME_END, CameraPose, frame_of, read_extrinsics
from im_cell.calibration_files.intrinsics import read_intrinsics
from im_cell.calibration_files.laser import LASER, LaserEstimate, read_laser
from im_cell.calibration_files.together import camera_files, read_between_changes
from im_cell.camera_covariance import CameraCovariance
from im_cell.camera_model import PARAMETERS, CameraModel
from im_cell.robot import Camera, Cell
from im_core.config import fault_in
from im_core.errors import ConfigError, NotFoundError
from im_core.files import FileError
from im_core.text.jsontext import load_json


@dataclass(frozen=True)
class CalibrationFiles:
    """Contents of a calibration folder.

    Attributes:
        folder: The folder.
        intrinsics: By camera; the models have no pose.
        poses: By camera.
        covariance: How well cameras are known of which both are given.
        laser: The laser scanner; None: as drawn.
        notes: What is odd but not wrong, one sentence each.
    """

    folder: Path
    intrinsics: Mapping[str, CameraModel]
    poses: Mapping[str, CameraPose]
    covariance: CameraCovariance = field(default_factory=CameraCovariance)
    laser: LaserEstimate | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def cameras(self) -> tuple[str, ...]:
        """Cameras with any known calibration."""
        return tuple(dict.fromkeys((*self.intrinsics, *self.poses)))

    def summary(self) -> str:
        """Summarise the contents of the folder in one line."""
        parts = []
        for camera in self.cameras:
            known = [word for word, kind in (("intrinsics", self.intrinsics), ("pose", self.poses)) if camera in kind]
            parts.append(f"{camera} ({' and '.join(known)})")
        if self.laser is not None:
            parts.append("laser scanner")
        return ", ".join(parts)


def read_calibration(folder: Path, cell: Cell) -> CalibrationFiles:
    """Read all calibrations of a folder.

    Args:
        folder: The folder: results of ``calibrate_camera``, or where ``/vss`` kept what it used.
        cell: The cell whose cameras they must be for.

    Raises:
        ConfigError: The folder is missing or holds no calibration, or a file of it is wrong; the message names file,
            line, field and value.
    """
    if not folder.is_dir():
        what = "it is a file, the folder around it is needed" if folder.exists() else "there is no such folder"
        raise ConfigError(f"{folder}: no calibration: {what}", file=str(folder))
    try:
        return read_between_changes(folder, lambda: _read(folder, cell))
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be read: {error.strerror}", file=str(folder)) from error


def _read(folder: Path, cell: Cell) -> CalibrationFiles:
    files = camera_files(folder)
    files += [folder / LASER] if (folder / LASER).exists() else []
    if not files:
        raise ConfigError(
            f"{folder}: no calibration: it holds no <camera>.yaml, {EXTRINSICS} or {LASER}{_reason(folder)}",
            file=str(folder),
        )
    intrinsics: dict[str, CameraModel] = {}
    poses: dict[str, CameraPose] = {}
    covariance = CameraCovariance()
    laser: LaserEstimate | None = None
    notes: list[str] = []
    for path in files:
        if path.name == EXTRINSICS:
            poses = _poses(path, cell.cameras)
        elif path.name == COVARIANCE:
            covariance = _covariance(path, cell.cameras)
        elif path.name == LASER:
            laser = read_laser(path)
        else:
            intrinsics[path.stem] = _intrinsics(path, cell.cameras, notes)
    covariance = covariance.only(intrinsics.keys() & poses.keys())
    return CalibrationFiles(folder, intrinsics, poses, covariance, laser, tuple(notes))


def _intrinsics(path: Path, cameras: Mapping[str, Camera], notes: list[str]) -> CameraModel:
    name = path.stem
    if name not in cameras:
        raise ConfigError(f"{path}: {NotFoundError(kind='camera', name=name, known=cameras).message}", file=str(path))
    content, lens = read_intrinsics(path), cameras[name].intrinsics
    for side, wanted in (("image_width", lens.width), ("image_height", lens.height)):
        if getattr(content, side) != wanted:
            raise fault_in(path, (side,), f"{getattr(content, side)}: {name} takes images of {wanted} px")
    if content.camera_name not in ("", name):
        if content.camera_name in cameras:
            raise fault_in(path, ("camera_name",), f"'{content.camera_name}': the name of the file says {name}")
        notes.append(f"{path}: camera_name is '{content.camera_name}', it is taken for {name}")
    return content.model


def _poses(path: Path, cameras: Mapping[str, Camera]) -> dict[str, CameraPose]:
    poses: dict[str, CameraPose] = {}
    for number, transform in enumerate(read_extrinsics(path).transforms):
        frame, place = transform.child_frame_id, ("transforms", number)
        name = frame.removesuffix(FRAME_END)
        if frame != frame_of(name) or name not in cameras:
            unknown = NotFoundError(kind="camera frame", name=frame, known=[frame_of(camera) for camera in cameras])
            raise fault_in(path, (*place, "child_frame_id"), unknown.message)
        if name in poses:
            raise fault_in(path, (*place, "child_frame_id"), f"'{frame}': given twice")
        if transform.header.frame_id != cameras[name].parent:
            sentence = f"'{transform.header.frame_id}': {name} is fixed to {cameras[name].parent}"
            raise fault_in(path, (*place, "header", "frame_id"), sentence)
        poses[name] = transform.pose
    return poses


def _covariance(path: Path, cameras: Mapping[str, Camera]) -> CameraCovariance:
    covariance = read_covariance(path)
    for rank, parameter in enumerate(covariance.parameters):
        camera, _, name = parameter.rpartition(".")
        if camera not in cameras:
            unknown = NotFoundError(kind="camera", name=camera, known=cameras)
            raise fault_in(path, ("parameters", rank), f"'{parameter}': {unknown.message}")
        if name not in PARAMETERS:
            sentence = f"'{parameter}': a camera has {', '.join(PARAMETERS)}"
            raise fault_in(path, ("parameters", rank), sentence)
    return covariance


def _reason(folder: Path) -> str:
    """Return the reason why a calibration left no files, if the report gives one."""
    try:
        report = load_json(folder / "report.json")
    except FileError:
        return ""
    match report:
        case {"success": False, "message": str(message)}:
            return f"; its report.json says: {message}"
    return ""
