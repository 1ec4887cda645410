"""Vision Module of the cameras' shutters."""

from functools import partial
from typing import ClassVar

from im_vss.frames import FrameSet, SnapOrder
from im_vss.managers.lease import Lease
from im_vss.modules.module import VisionModule


class VmSnap(VisionModule):
    """Takes images (paper: vmSnap)."""

    name: ClassVar[str] = "vm_snap"

    def snap(self, lease: Lease, order: SnapOrder) -> FrameSet:
        """Expose all cameras of the order together and read them out.

        Raises:
            ImError: See :meth:`VisionModule.run` and :meth:`im_vss.frames.FrameSource.take`.
        """
        return self.run(lease, partial(self.rig.source.take, order))
