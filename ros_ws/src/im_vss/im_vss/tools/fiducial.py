"""Tools for fiducials in an image, and for the poses."""

from collections.abc import Mapping
from typing import ClassVar

from im_cell.frames import Frame
from im_cell.robot import Target
from im_vss.fiducial import FiducialFit, find_fiducials
from im_vss.tools.tool import Tool


class ToolFiducialPose(Tool):
    """Tool for fiducials and the poses; a calculation, without a Vision Module."""

    name: ClassVar[str] = "tool_fiducial_pose"

    def __call__(self, frame: Frame, wanted: Mapping[int, Target]) -> tuple[list[FiducialFit], dict[int, str]]:
        """Return the plates in an image, and the causes of missing ones."""
        sensor = frame.controls.of(self.rig.settings.sensor)
        known = self.rig.book.covariance.of([frame.camera])
        return find_fiducials(frame.image, self.rig.book[frame.camera].model, sensor, wanted, known)
