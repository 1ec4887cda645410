"""Vision Module of the cameras' shutters."""

from functools import partial
from typing import ClassVar

from im_cell.frames import Exposed, FrameSet, SnapOrder, nobody
from im_vss.managers.vmm import Lease
from im_vss.modules.module import VisionModule

_SAME_S = 1e-6
"""Exposures that differ by less are of the same length."""


class VmSnap(VisionModule):
    """Takes images (paper: vmSnap)."""

    name: ClassVar[str] = "vm_snap"

    def snap(self, lease: Lease, order: SnapOrder, exposed: Exposed = nobody) -> FrameSet:
        """Expose all cameras of the order together, tell `exposed`, and read them out.

        The client is told where the exposures were not of the length that was ordered. Where the robot held the cameras
        is noted.

        Raises:
            ImError: See :meth:`VisionModule.run` and :meth:`im_cell.frames.FrameSource.take_frames`.
        """
        frames = self.run(lease, partial(self.rig.source.take_frames, order, exposed))
        if abs(frames.exposure_s - order.exposure_s) > _SAME_S:
            lease.client.tell(f"exposed for {frames.exposure_s:g} s, not for {order.exposure_s:g} s")
        for camera, taken in frames.frames.items():
            if (parent := self.rig.book[camera].parent) != "world":
                self.rig.mounts.note(parent, [frame.stamp_ns for frame in taken])
        return frames
