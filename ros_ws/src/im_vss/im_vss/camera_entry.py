"""What is known of a camera at present, and from which file."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from im_core.calibration_files import EXTRINSICS, CameraPose, Rectified, frame_of
from im_core.camera_model import CameraModel
from im_core.errors import DataError


@dataclass(frozen=True)
class CameraEntry:
    """What is known of a camera.

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
        """Name of its optical frame."""
        return frame_of(self.name)

    @property
    def calibrated(self) -> bool:
        """Whether intrinsics and lens, and the pose, are better known than by the drawing.

        Either alone does not tell where in the world a pixel looks.
        """
        return self.intrinsics_file is not None and self.pose_file is not None

    def told(self) -> str:
        """Where its calibration comes from, in a sentence."""
        return f"{self.name}: {self.origin}"

    @property
    def origin(self) -> str:
        """Files of its lens and pose, or that they are the drawing's."""
        if self.intrinsics_file is None and self.pose_file is None:
            return "as drawn"
        lens, pose = (str(file) if file is not None else "as drawn" for file in (self.intrinsics_file, self.pose_file))
        return f"intrinsics {lens}, pose {pose}"

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
        model = replace(old, K=lens.K, D=lens.D)
        return replace(self, model=model, intrinsics_file=folder / f"{self.name}.yaml")

    def with_pose(self, pose: CameraPose, folder: Path) -> Self:
        """The entry with a pose relative to its parent, from the poses' file in `folder`."""
        model = replace(self.model, R_cam_base=pose.R_cam_base, t_cam_base=pose.t_cam_base)
        return replace(self, model=model, pose_file=folder / EXTRINSICS)
