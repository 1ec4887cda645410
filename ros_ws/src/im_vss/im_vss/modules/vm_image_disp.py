"""Vision Module of the monitors' image planes."""

from functools import partial
from typing import ClassVar

from im_cell.frames import Frame
from im_vss.managers.vmm import Lease
from im_vss.modules.module import VisionModule


class VmImageDisp(VisionModule):
    """Shows images on the cameras' monitors (paper: vmImageDisp)."""

    name: ClassVar[str] = "vm_image_disp"

    def show(self, lease: Lease, frames: tuple[Frame, ...]) -> None:
        """Put each image out as it was taken, and on its camera's monitor.

        Raises:
            ImError: See :meth:`VisionModule.run`.
        """
        self.run(lease, partial(self._show, frames))

    def _show(self, frames: tuple[Frame, ...]) -> None:
        for frame in frames:
            self.rig.screen.raw(frame)
            self.rig.monitors.show(frame)
