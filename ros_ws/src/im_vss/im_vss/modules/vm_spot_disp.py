"""Vision Module of the monitors' overlay planes."""

from functools import partial
from typing import ClassVar

from im_vss.managers.vmm import Lease
from im_vss.modules.module import VisionModule
from im_vss.monitor import Marker


class VmSpotDisp(VisionModule):
    """Draws markers over the images on the monitors (paper: vmSpotDisp)."""

    name: ClassVar[str] = "vm_spot_disp"

    def mark(self, lease: Lease, markers: tuple[Marker, ...]) -> None:
        """Draw the markers and show the result.

        Raises:
            ImError: See :meth:`VisionModule.run`.
        """
        self.run(lease, partial(self._mark, markers))

    def _mark(self, markers: tuple[Marker, ...]) -> None:
        for marker in markers:
            shown = self.rig.monitors.draw(marker)
            if shown is not None:
                self.rig.screen.display(marker.camera, shown.image, shown.stamp_ns)
