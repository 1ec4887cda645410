"""The present calibration of each camera: nominal until something better is set."""

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from im_core.camera_model import CameraModel
from im_core.errors import DataError, NotFoundError
from im_core.robot import Camera, Cell
from im_vss.camera_info import Rectified, camera_info_yaml, monocular
from im_vss.stereo import rectify


@dataclass(frozen=True)
class CameraEntry:
    """What is known of a camera.

    Attributes:
        name: Its name.
        parent: Frame of the robot it is fixed to.
        model: Intrinsics, lens and pose; the pose is relative to `parent`.
        rectified: R and P of its camera infos; those of its stereo pair if it belongs to one.
        calibrated: Whether intrinsics have been set since the start.
    """

    name: str
    parent: str
    model: CameraModel
    rectified: Rectified
    calibrated: bool = False

    @property
    def frame(self) -> str:
        """Name of its optical frame."""
        return f"{self.name}_optical_frame"


class CameraBook:
    """Calibrations by camera; what is set is also written to a file in the format of `camera_info_manager`."""

    def __init__(
        self, cell: Cell, cameras: Iterable[str], directory: Path, pairs: Iterable[tuple[str, str]] = ()
    ) -> None:
        """Start from the nominal cameras of `cell`.

        Args:
            cell: Nominal cameras.
            cameras: Those in use.
            directory: Where calibration files go.
            pairs: Left and right cameras of the stereo pairs.

        Raises:
            DataError: The cameras of a pair move against each other.
        """
        self._entries: dict[str, CameraEntry] = {}
        for name in cameras:
            model = nominal(cell.cameras[name])
            self._entries[name] = CameraEntry(name, cell.cameras[name].parent, model, monocular(model))
        self._pairs = tuple(pairs)
        self._directory = directory
        self._lock = threading.Lock()
        for left, right in self._pairs:
            if self._entries[left].parent != self._entries[right].parent:
                raise DataError(f"{left} and {right} are no stereo pair: they move against each other")
        self._rectify()
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
        self._put(replace(entry, model=replace(old, K=model.K, D=model.D), calibrated=True))
        path = self._directory / f"{name}.yaml"
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            for kept in self.entries():
                if kept.calibrated:
                    text = camera_info_yaml(kept.name, kept.model, kept.rectified)
                    (self._directory / f"{kept.name}.yaml").write_text(text, encoding="utf-8")
        except OSError as error:
            raise DataError(f"{path}: cannot be written: {error.strerror}", file=str(path)) from error
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
            self._rectify()
        self.on_change()

    def _rectify(self) -> None:
        """Renew R and P; cameras whose images can have no rows in common are described as single ones."""
        for name, entry in self._entries.items():
            self._entries[name] = replace(entry, rectified=monocular(entry.model))
        for left, right in self._pairs:
            first, second = self._entries[left], self._entries[right]
            try:
                rectification = rectify(first.model, second.model)
            except DataError:
                continue
            self._entries[left] = replace(first, rectified=Rectified(*rectification.left))
            self._entries[right] = replace(second, rectified=Rectified(*rectification.right))


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
