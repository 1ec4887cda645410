"""Tool that estimates the laser scanner's pose and mirrors."""

from collections.abc import Sequence
from typing import ClassVar

from im_vss.laser.calibration import LaserCalibration, LaserSpot, calibrate
from im_vss.tools.tool import Tool


class ToolLaserCalibrate(Tool):
    """A calculation, without a Vision Module."""

    name: ClassVar[str] = "tool_laser_calibrate"

    def __call__(self, spots: Sequence[LaserSpot]) -> LaserCalibration:
        """The estimate from some spots, with its verdicts."""
        return calibrate(self.rig.cell.laser, spots, self.rig.settings.laser.calibration)
