"""The present calibration of each camera, and the file: nominal until a better one is set."""

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from im_cell.calibration_files import (
    COVARIANCE,
    EXTRINSICS,
    CalibrationFiles,
    CameraPose,
    Rectified,
    camera_info_yaml,
    change_camera_files,
    covariance_yaml,
    extrinsics_yaml,
    frame_of,
    monocular,
)
from im_cell.camera_covariance import CameraCovariance
from im_cell.camera_model import Array, CameraModel, nominal
from im_cell.robot import Cell
from im_core.errors import DataError, NotFoundError
from im_vss.stereo import rectify


@dataclass(frozen=True)
class CameraEntry:
    """Calibration of a camera, and the origin.

    Attributes:
        name: Its name.
        parent: Frame of the robot it is fixed to.
        model: Intrinsics, lens and pose; the pose is relative to `parent`.
        rectified: R and P of its camera infos; those of its stereo pair if it belongs to one.
        intrinsics_file: File of intrinsics and lens; None: they are the drawing's.
        pose_file: File of the pose; None: it is the drawing's.
    """

    name: str
    parent: str
    model: CameraModel
    rectified: Rectified
    intrinsics_file: Path | None = None
    pose_file: Path | None = None

    @property
    def frame(self) -> str:
        """Name of the optical frame of the camera."""
        return frame_of(self.name)

    @property
    def lens_known(self) -> bool:
        """Whether intrinsics and lens are better known than by the drawing: enough for poses relative to the camera."""
        return self.intrinsics_file is not None

    @property
    def calibrated(self) -> bool:
        """Whether intrinsics and lens, and the pose, are better known than by the drawing.

        Either alone does not tell where in the world a pixel looks.
        """
        return self.lens_known and self.pose_file is not None

    def told(self) -> str:
        """Return the origin of the calibration, as a sentence."""
        return f"{self.name}: {self.origin}"

    @property
    def origin(self) -> str:
        """Files of lens and pose, or the drawing; with a remark on a lens that does not hold in the whole image."""
        if self.intrinsics_file is None and self.pose_file is None:
            return "as drawn"
        lens, pose = (str(file) if file is not None else "as drawn" for file in (self.intrinsics_file, self.pose_file))
        share = self.model.invertible_share
        where = f", in the middle {100.0 * share:.0f} % of the image's sides only" if share < 1.0 else ""
        return f"intrinsics {lens}{where}, pose {pose}"

    def with_intrinsics(self, lens: CameraModel, folder: Path) -> Self:
        """The entry with intrinsics and lens of `lens`, from the camera's file in `folder`.

        Raises:
            DataError: The image size is not the camera's.
        """
        old = self.model
        if (lens.width, lens.height) != (old.width, old.height):
            raise DataError(
                f"{self.name} takes images of {old.width} x {old.height} px, the calibration is for "
                f"{lens.width} x {lens.height} px",
                camera=self.name,
            )
        model = replace(old, K=lens.K, D=lens.D, distortion_model=lens.distortion_model)
        return replace(self, model=model, intrinsics_file=folder / f"{self.name}.yaml")

    def with_pose(self, pose: CameraPose, folder: Path) -> Self:
        """Return the entry with a pose relative to the parent, from the poses' file in `folder`."""
        model = replace(self.model, R_cam_base=pose.R_cam_base, t_cam_base=pose.t_cam_base)
        return replace(self, model=model, pose_file=folder / EXTRINSICS)


class CameraBook:
    """Calibrations by camera; each setting is also written to files, see :mod:`im_cell.calibration_files`.

    Attributes:
        on_change: Called after each change.
        residuals: Spots of the last calibration of a camera and the residual of each, shape (n, 2) both, NaN where not
            seen [px].
    """

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
        entries: dict[str, CameraEntry] = {}
        for name in cameras:
            model = nominal(cell.cameras[name])
            entries[name] = CameraEntry(name, cell.cameras[name].parent, model, monocular(model))
        self._pairs = tuple(pairs)
        self._directory = directory
        self._changing = threading.Lock()
        for left, right in self._pairs:
            if entries[left].parent != entries[right].parent:
                raise DataError(f"{left} and {right} are no stereo pair: they move against each other")
        self._entries: Mapping[str, CameraEntry] = _rectified(entries, self._pairs)
        self._covariance = CameraCovariance()
        self.on_change: Callable[[], None] = lambda: None
        self.residuals: dict[str, tuple[Array, Array]] = {}

    def __getitem__(self, name: str) -> CameraEntry:
        """The entry of a camera.

        Raises:
            NotFoundError: It is not known.
        """
        entries = self._entries
        if name not in entries:
            raise NotFoundError(kind="camera", name=name, known=entries)
        return entries[name]

    def entries(self) -> tuple[CameraEntry, ...]:
        """All entries, in the order of the settings."""
        return tuple(self._entries.values())

    @property
    def covariance(self) -> CameraCovariance:
        """How well cameras are known, as far as is known."""
        return self._covariance

    def remark(self, cameras: Iterable[str]) -> str:
        """Return a remark on covariances by some cameras, a clause; empty for complete covariances."""
        unknown = [camera for camera in cameras if camera not in self._covariance.cameras]
        if not unknown:
            return ""
        told = f"{' and '.join(unknown)} {'is' if len(unknown) == 1 else 'are'} known"
        return f"covariances are of the pixels alone: the calibration does not say how well {told}"

    def set_cameras(
        self,
        models: Mapping[str, CameraModel],
        covariance: CameraCovariance | None = None,
        *,
        intrinsics: bool = True,
        pose: bool = True,
    ) -> Path:
        """Set cameras at one stroke.

        Args:
            models: By name.
            covariance: How well they are known; None: nobody says.
            intrinsics: Whether intrinsics and lenses are set.
            pose: Whether poses are, relative to the cameras' parents.

        Returns:
            The folder of the files.

        Raises:
            NotFoundError: A camera is not known.
            DataError: An image size is not the camera's, or the files cannot be written; nothing has changed then.
        """
        with self._changing:
            entries = {}
            for name, model in models.items():
                entry = self[name]
                if intrinsics:
                    entry = entry.with_intrinsics(model, self._directory)
                if pose:
                    entry = entry.with_pose(CameraPose.of(entry.parent, model), self._directory)
                entries[name] = entry
            folder = self._set(entries, covariance or CameraCovariance())
        self.on_change()
        return folder

    def rectified(self, models: Mapping[str, CameraModel]) -> dict[str, Rectified]:
        """Return R and P of cameras with the given models; the stereo pair's R and P where both are given.

        Raises:
            NotFoundError: A camera is not known.
        """
        entries = {name: replace(self[name], model=model) for name, model in models.items()}
        pairs = [pair for pair in self._pairs if models.keys() >= set(pair)]
        return {name: entry.rectified for name, entry in _rectified(entries, pairs).items()}

    def adopt(self, files: CalibrationFiles) -> tuple[str, ...]:
        """Use calibrations of an earlier run, and write the calibrations in use now.

        Returns:
            A sentence for each camera that is not in use.

        Raises:
            DataError: The files cannot be written; nothing has changed then.
        """
        with self._changing:
            entries = {name: self._entries[name] for name in files.cameras if name in self._entries}
            for name, entry in entries.items():
                if (lens := files.intrinsics.get(name)) is not None:
                    entry = entry.with_intrinsics(lens, files.folder)
                if (pose := files.poses.get(name)) is not None:
                    entry = entry.with_pose(pose, files.folder)
                entries[name] = entry
            self._put(entries, files.covariance)
        self.on_change()
        return tuple(
            f"{name} is not in use; its calibration is passed over" for name in files.cameras if name not in entries
        )

    def files(self) -> dict[str, str]:
        """Return the contents of the files of all that is calibrated, by name."""
        with self._changing:
            return _files(self._entries.values(), self._covariance)

    def _set(self, changed: Mapping[str, CameraEntry], anew: CameraCovariance) -> Path:
        """Take into use what was calibrated here, under the lock; return the folder of its files."""
        self._put(changed, anew)
        return self._directory

    def _put(self, changed: Mapping[str, CameraEntry], anew: CameraCovariance) -> None:
        """Write, then use; under the lock."""
        entries = _rectified({**self._entries, **changed}, self._pairs)
        covariance = self._covariance.updated(changed, anew)
        self._write(_files(entries.values(), covariance))
        self._entries, self._covariance = entries, covariance

    def _write(self, contents: dict[str, str]) -> None:
        try:
            change_camera_files(self._directory, {COVARIANCE: None, **contents})
        except OSError as error:
            directory = str(self._directory)
            raise DataError(f"{directory}: cannot be written: {error.strerror}", file=directory) from error


class RemoteBook(CameraBook):
    """Calibrations of cameras that are in another process: followed, and set by handing files over to it.

    Args:
        cell: Nominal cameras.
        cameras: Those in use.
        pairs: Left and right cameras of the stereo pairs.
        hand_over: Has the other process use the files of a calibration, by name; returns their folder there.

    Raises:
        DataError: The cameras of a pair move against each other.
    """

    def __init__(
        self,
        cell: Cell,
        cameras: Iterable[str],
        pairs: Iterable[tuple[str, str]],
        hand_over: Callable[[Mapping[str, str]], Path],
    ) -> None:
        super().__init__(cell, cameras, Path(), pairs)
        self._hand_over = hand_over

    def _set(self, changed: Mapping[str, CameraEntry], anew: CameraCovariance) -> Path:
        return self._hand_over(_files(changed.values(), anew))

    def _write(self, contents: dict[str, str]) -> None:
        """Write nothing: the other process did."""


def _files(entries: Iterable[CameraEntry], covariance: CameraCovariance) -> dict[str, str]:
    contents, poses = {}, {}
    for entry in entries:
        if entry.intrinsics_file is not None:
            contents[f"{entry.name}.yaml"] = camera_info_yaml(entry.name, entry.model, entry.rectified)
        if entry.pose_file is not None:
            poses[entry.name] = CameraPose.of(entry.parent, entry.model)
    if poses:
        contents[EXTRINSICS] = extrinsics_yaml(poses)
    if covariance.parameters:
        contents[COVARIANCE] = covariance_yaml(covariance)
    return contents


def _rectified(entries: Mapping[str, CameraEntry], pairs: Iterable[tuple[str, str]]) -> Mapping[str, CameraEntry]:
    """Return cameras with new R and P; cameras without common image rows are described as single ones."""
    renewed = {name: replace(entry, rectified=monocular(entry.model)) for name, entry in entries.items()}
    for left, right in pairs:
        first, second = renewed[left], renewed[right]
        try:
            rectification = rectify(first.model, second.model)
        except DataError:
            continue
        renewed[left] = replace(first, rectified=Rectified(*rectification.left))
        renewed[right] = replace(second, rectified=Rectified(*rectification.right))
    return renewed
