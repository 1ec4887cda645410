"""Tools for taking an image, and for showing the image on the monitor."""

from typing import ClassVar

from im_cell.frames import Exposed, FrameSet, nobody
from im_vss.managers import VisionClient
from im_vss.tools.tool import Tool


class ToolSnap(Tool):
    """Captures images with one or more cameras at the same time (paper: toolSnap)."""

    name: ClassVar[str] = "tool_snap"

    def __call__(
        self,
        client: VisionClient,
        cameras: tuple[str, ...],
        exposure_s: float,
        blank_light: tuple[bool, ...],
        blank_laser: tuple[bool, ...] = (),
        exposed: Exposed = nobody,
    ) -> FrameSet:
        """Expose one frame for each element of `blank_light`, all cameras together.

        Args:
            client: Who asks.
            cameras: Names of the cameras.
            exposure_s: Length of each exposure [s]; 0: the one that is set.
            blank_light: For each frame, whether the wrist lights are strobed off.
            blank_laser: For each frame, whether the laser is; empty: in none.
            exposed: Called when all is exposed, before the images are there.

        Raises:
            ImError: A camera is unknown, the exposure out of range, or the cameras do not deliver.
        """
        order = self.rig.order(cameras, exposure_s, blank_light, blank_laser)
        with self.modules.use("vm_snap", client) as (vm_snap, lease):
            frames: FrameSet = vm_snap.snap(lease, order, exposed)
        return frames


class ToolImageDisp(Tool):
    """Tool for captured images on the cameras' monitors (paper: toolImageDisp)."""

    name: ClassVar[str] = "tool_image_disp"

    def __call__(self, client: VisionClient, images: FrameSet) -> None:
        """Show all frames in the order of the exposures.

        Raises:
            ImError: The display is not to be had.
        """
        frames = tuple(frame for sequence in images.frames.values() for frame in sequence)
        with self.modules.use("vm_image_disp", client) as (vm_image_disp, lease):
            vm_image_disp.show(lease, frames)
