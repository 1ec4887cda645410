"""Tools for fiducials in images, and for the poses."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

from im_cell.frames import Frame
from im_cell.robot import Target
from im_vss.fiducial import FiducialFit, find_fiducials
from im_vss.tools.tool import Tool


class ToolFiducialPose(Tool):
    """Tool for fiducials and the poses; a calculation, without a Vision Module."""

    name: ClassVar[str] = "tool_fiducial_pose"

    def __call__(
        self, frames: Sequence[Frame], wanted: Mapping[int, Target]
    ) -> tuple[list[FiducialFit], dict[int, str]]:
        """Return the plates in images of a camera, and the causes of missing ones."""
        first, images = frames[0], [frame.image for frame in frames]
        sensor = first.controls.of(self.rig.settings.sensor)
        known = self.rig.book.covariance.of([first.camera])
        return find_fiducials(images, self.rig.book[first.camera].model, sensor, wanted, known)
