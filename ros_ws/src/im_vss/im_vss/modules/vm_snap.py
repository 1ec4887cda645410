"""Vision Module of the cameras' shutters."""

from functools import partial
from typing import ClassVar

from im_cell.frames import Exposed, FrameSet, SnapOrder, nobody
from im_vss.managers.vmm import Lease
from im_vss.modules.module import VisionModule


class VmSnap(VisionModule):
    """Takes images (paper: vmSnap)."""

    name: ClassVar[str] = "vm_snap"

    def snap(self, lease: Lease, order: SnapOrder, exposed: Exposed = nobody) -> FrameSet:
        """Expose all cameras of the order together, tell `exposed`, and read them out.

        Raises:
            ImError: See :meth:`VisionModule.run` and :meth:`im_cell.frames.FrameSource.take_frames`.
        """
        return self.run(lease, partial(self.rig.source.take_frames, order, exposed))
