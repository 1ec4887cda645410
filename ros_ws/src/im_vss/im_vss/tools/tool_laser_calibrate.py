"""Tool that estimates the laser scanner's pose and mirrors."""

from collections.abc import Sequence
from typing import ClassVar

from im_vss.laser.calibration import LaserCalibration, LaserSpot, calibrate
from im_vss.tools.tool import Tool


class ToolLaserCalibrate(Tool):
    """A calculation, without a Vision Module."""

    name: ClassVar[str] = "tool_laser_calibrate"

    def __call__(self, cameras: Sequence[str], spots: Sequence[LaserSpot]) -> LaserCalibration:
        """The estimate from some spots, with its verdicts.

        Args:
            cameras: Names of those that saw the spots, in the order in which these were triangulated.
            spots: What they saw.
        """
        known = self.rig.book.covariance.of(cameras)
        return calibrate(self.rig.cell.laser, spots, known, self.rig.settings.laser.calibration)
