"""Service that says where in the world the laser's spot is."""

from dataclasses import dataclass, replace
from typing import ClassVar

from im_cell.link import LaserBeam
from im_core.stopwatch import Stopwatch
from im_vss.managers import VisionClient
from im_vss.services.laser_spots import fixed_cameras, look, why_not
from im_vss.services.service import VisionService
from im_vss.services.svc_spot_find import CameraSpot
from im_vss.tools.tool_triangulate import StereoFinding


@dataclass(frozen=True)
class LaserSpot3dRequest:
    """Where does the beam end at some angles of the mirrors [rad]; None: where it points now, as it is lit."""

    cameras: tuple[str, ...]
    angles: tuple[float, float] | None
    exposure_s: float = 0.0


@dataclass(frozen=True)
class LaserSpot3dResult:
    """What each camera saw, what follows from it, what the scanner's sensors said, and where the time went [s].

    `remark` is what a user must know to trust the covariance; empty: nothing.
    """

    spots: tuple[CameraSpot, ...]
    stereo: StereoFinding
    beam: LaserBeam
    timing: dict[str, float]
    remark: str


class SvcLaserSpot3d(VisionService):
    """Points the beam, takes frames without and with it, finds its spot in two cameras, and triangulates."""

    name: ClassVar[str] = "laser_spot_3d"

    def serve(self, client: VisionClient, request: LaserSpot3dRequest) -> LaserSpot3dResult:
        """Find the spot.

        Raises:
            ImError: The cameras are not two that are fixed and calibrated, a mirror would turn too far, or the
                hardware does not deliver. A spot that is not found is no error: the finding says why.
        """
        cameras = fixed_cameras(self.rig, request.cameras, 2)
        watch = Stopwatch()
        power = self.rig.settings.laser.spot_power
        beam = None if request.angles is None else LaserBeam(*request.angles, power=power)
        with watch.step("look_s"):
            spots, stereo, reading, images = look(self, client, cameras, beam, request.exposure_s)
        with watch.step("display_s"):
            self.tool("tool_image_disp")(client, images)
            self.tool("tool_spot_disp")(client, {spot.camera: spot.finding for spot in spots})
        stereo = replace(stereo, cause=why_not(self.rig, spots, stereo, reading))
        remark = "" if stereo.point is None else self.rig.book.remark(cameras)
        return LaserSpot3dResult(spots, stereo, reading, {**images.timing, **watch.report()}, remark)
