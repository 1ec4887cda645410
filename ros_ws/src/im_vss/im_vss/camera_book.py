"""The present calibration of each camera: nominal until something better is set."""

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from im_core.camera_model import CameraModel
from im_core.errors import DataError, NotFoundError
from im_core.robot import Camera, Cell
from im_vss.camera_info import camera_info_yaml


@dataclass(frozen=True)
class CameraEntry:
    """What is known of a camera.

    Attributes:
        name: Its name.
        parent: Frame of the robot it is fixed to.
        model: Intrinsics, lens and pose; the pose is relative to `parent`.
        calibrated: Whether intrinsics have been set since the start.
    """

    name: str
    parent: str
    model: CameraModel
    calibrated: bool = False

    @property
    def frame(self) -> str:
        """Name of its optical frame."""
        return f"{self.name}_optical_frame"


class CameraBook:
    """Calibrations by camera; what is set is also written to a file in the format of `camera_info_manager`."""

    def __init__(self, cell: Cell, cameras: Iterable[str], directory: Path) -> None:
        """Start from the nominal cameras of `cell`; files go to `directory`."""
        self._entries = {
            name: CameraEntry(name, cell.cameras[name].parent, nominal(cell.cameras[name])) for name in cameras
        }
        self._directory = directory
        self._lock = threading.Lock()
        self.on_change: Callable[[], None] = lambda: None

    def __getitem__(self, name: str) -> CameraEntry:
        """The entry of a camera.

        Raises:
            NotFoundError: It is not known.
        """
        with self._lock:
            if name not in self._entries:
                raise NotFoundError(kind="camera", name=name, known=self._entries)
            return self._entries[name]

    def entries(self) -> tuple[CameraEntry, ...]:
        """All entries, in the order of the settings."""
        with self._lock:
            return tuple(self._entries.values())

    def set_intrinsics(self, name: str, model: CameraModel) -> Path:
        """Set intrinsics and lens of a camera; its pose stays.

        Args:
            name: Name of the camera.
            model: Source of width, height, K and D.

        Returns:
            The file that was written.

        Raises:
            NotFoundError: The camera is not known.
            DataError: The image size is not the camera's, or the file cannot be written.
        """
        entry = self[name]
        old = entry.model
        if (model.width, model.height) != (old.width, old.height):
            raise DataError(
                f"{name} takes images of {old.width} x {old.height} px, the calibration is for "
                f"{model.width} x {model.height} px",
                camera=name,
            )
        path = self._directory / f"{name}.yaml"
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            path.write_text(camera_info_yaml(name, model), encoding="utf-8")
        except OSError as error:
            raise DataError(f"{path}: cannot be written: {error.strerror}", file=str(path)) from error
        self._put(replace(entry, model=replace(old, K=model.K, D=model.D), calibrated=True))
        return path

    def set_pose(self, name: str, model: CameraModel) -> None:
        """Set the pose of a camera, relative to its parent, from `model`.

        Raises:
            NotFoundError: The camera is not known.
        """
        entry = self[name]
        pose = replace(entry.model, R_cam_base=model.R_cam_base, t_cam_base=model.t_cam_base)
        self._put(replace(entry, model=pose))

    def _put(self, entry: CameraEntry) -> None:
        with self._lock:
            self._entries[entry.name] = entry
        self.on_change()


def nominal(camera: Camera) -> CameraModel:
    """A camera as the cell's drawing has it, without distortion."""
    lens = camera.intrinsics
    rotation, translation = camera.pose()
    return CameraModel(
        width=lens.width,
        height=lens.height,
        K=np.array([[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]]),
        D=np.zeros(5),
        R_cam_base=rotation,
        t_cam_base=translation,
    )
