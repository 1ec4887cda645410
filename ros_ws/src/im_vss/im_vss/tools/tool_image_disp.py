"""Tool that shows images."""

from typing import ClassVar

from im_cell.frames import FrameSet
from im_vss.managers import VisionClient
from im_vss.tools.tool import Tool


class ToolImageDisp(Tool):
    """Shows captured images on their cameras' monitors (paper: toolImageDisp)."""

    name: ClassVar[str] = "tool_image_disp"

    def __call__(self, client: VisionClient, images: FrameSet) -> None:
        """Show all frames in the order they were taken.

        Raises:
            ImError: The display is not to be had.
        """
        frames = tuple(frame for sequence in images.frames.values() for frame in sequence)
        with self.modules.use("vm_image_disp", client) as (vm_image_disp, lease):
            vm_image_disp.show(lease, frames)
