"""Service that points the laser."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from im_cell.link import LaserBeam
from im_vss.managers import VisionClient
from im_vss.services.service import VisionService


@dataclass(frozen=True)
class LaserPointRequest:
    """Point the beam to angles of the mirrors [rad], or, if given, to a point in the world, shape (3,) [m]."""

    angles: tuple[float, float]
    target: NDArray[np.float64] | None
    on: bool


@dataclass(frozen=True)
class LaserPointResult:
    """What the scanner's sensors say, testbed time then [ns], and whether the scanner is calibrated."""

    beam: LaserBeam
    stamp_ns: int
    calibrated: bool


class SvcLaserPoint(VisionService):
    """Points the beam; it stays where it points until the next request."""

    name: ClassVar[str] = "laser_point"

    def serve(self, client: VisionClient, request: LaserPointRequest) -> LaserPointResult:
        """Point.

        Raises:
            ImError: The target is behind the scanner, a mirror would turn too far, or the scanner is not there.
        """
        tool = self.tool("tool_laser_point")
        angles = request.angles if request.target is None else tool.angles_to(request.target)
        beam, stamp_ns = tool(client, angles, request.on)
        return LaserPointResult(beam, stamp_ns, self.rig.scanner.book.entry.calibrated)
