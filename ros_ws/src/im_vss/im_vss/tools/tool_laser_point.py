"""Tool that points the laser."""

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from im_cell.link import LaserBeam
from im_vss.managers import VisionClient
from im_vss.tools.tool import Tool


class ToolLaserPoint(Tool):
    """Computes the mirrors' angles for a target, and drives the scanner there."""

    name: ClassVar[str] = "tool_laser_point"

    def angles_to(self, target: NDArray[np.float64]) -> tuple[float, float]:
        """Angles at which the beam meets a point of the world, shape (3,) [m], by the scanner's calibration [rad].

        Raises:
            DataError: The point is not finite, or behind the scanner.
            StateError: There is no scanner.
        """
        first, second = self.rig.scanner.book.entry.model.angles_to(target).tolist()
        return first, second

    def __call__(self, client: VisionClient, angles: tuple[float, float], on: bool) -> tuple[LaserBeam, int]:
        """Point the beam; it stays so.

        Args:
            client: Who asks.
            angles: Of the mirrors [rad].
            on: Whether the beam is lit.

        Returns:
            What the scanner's sensors say, and the testbed time then [ns].

        Raises:
            ImError: A mirror would turn too far, or the scanner is not there.
        """
        beam = LaserBeam(*angles, power=self.rig.settings.laser.spot_power if on else 0.0)
        with self.modules.use("vm_laser", client) as (vm_laser, lease):
            reading: tuple[LaserBeam, int] = vm_laser.drive(lease, beam)
        return reading
