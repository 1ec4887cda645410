"""Tool that captures images with and without the laser."""

from typing import ClassVar

from im_cell.frames import FrameSet
from im_cell.link import LaserBeam
from im_vss.managers import VisionClient
from im_vss.tools.tool import Tool


class ToolLaserSnap(Tool):
    """Points the laser and takes a pair of frames, holding both hardware's leases: nobody moves a mirror in between.

    The lease of the laser may be over when the cameras are free, or when they have exposed: then there are no frames.
    """

    name: ClassVar[str] = "tool_laser_snap"

    def __call__(
        self, client: VisionClient, cameras: tuple[str, ...], beam: LaserBeam | None, exposure_s: float
    ) -> tuple[FrameSet, LaserBeam]:
        """Expose a frame without the laser and one with it, all cameras together, wrist lights strobed off.

        Args:
            client: Who asks.
            cameras: Names of the cameras.
            beam: What to show, dark afterwards; None: as the scanner is, and stays.
            exposure_s: Length of each exposure [s]; 0: the one that is set.

        Returns:
            The frames, and what the scanner's sensors said.

        Raises:
            ImError: A camera is unknown, the exposure out of range, a mirror would turn too far, or the hardware does
                not deliver.
        """
        order = self.rig.order(cameras, exposure_s, (True, True), (True, False))
        with self.modules.use("vm_laser", client) as (vm_laser, laser_lease):
            try:
                if beam is None:
                    reading: LaserBeam = vm_laser.reading(laser_lease)
                else:
                    reading, _ = vm_laser.drive(laser_lease, beam)
                with self.modules.use("vm_snap", client) as (vm_snap, snap_lease):
                    laser_lease.check(vm_laser.name)
                    frames: FrameSet = vm_snap.snap(snap_lease, order)
                    laser_lease.check(vm_laser.name)
            finally:
                if beam is not None:
                    vm_laser.darken(beam)
        return frames, reading
