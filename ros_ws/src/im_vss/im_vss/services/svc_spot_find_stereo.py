"""Service that finds the light spot with two cameras and says where the light is."""

from dataclasses import dataclass
from typing import ClassVar

from im_core.errors import ConfigError, DataError
from im_core.stopwatch import Stopwatch
from im_vss.managers import VisionClient
from im_vss.services.service import VisionService
from im_vss.services.svc_spot_find import CameraSpot, find_in_pairs
from im_vss.tools.tool_triangulate import StereoFinding


@dataclass(frozen=True)
class SpotFindStereoRequest:
    """Find the light with two cameras, exposed at the same time; exposure 0 stands for the nominal one [s]."""

    cameras: tuple[str, ...]
    exposure_s: float = 0.0


@dataclass(frozen=True)
class SpotFindStereoResult:
    """What each camera saw, in the order of the request, what follows from it, and where the time went [s].

    `remark` is what a user must know to trust the covariance; empty: nothing.
    """

    spots: tuple[CameraSpot, ...]
    stereo: StereoFinding
    timing: dict[str, float]
    remark: str


class SvcSpotFindStereo(VisionService):
    """As SpotFind with two cameras, and triangulated."""

    name: ClassVar[str] = "spot_find_stereo"

    def serve(self, client: VisionClient, request: SpotFindStereoRequest) -> SpotFindStereoResult:
        """Find the light.

        Raises:
            ImError: The cameras are not two that are fixed to the world, the exposure is out of range, or the cameras
                do not deliver. A light that is not found is no error: the finding says why.
        """
        cameras = self.rig.settings.check_cameras(request.cameras)
        if len(cameras) != 2:
            raise ConfigError(f"stereo needs two cameras, got {len(cameras)}: {', '.join(cameras)}")
        for camera in cameras:
            if self.rig.book[camera].parent != "world":
                raise DataError(f"{camera} moves with {self.rig.book[camera].parent}: stereo needs fixed cameras")
        watch = Stopwatch()
        spots, timing = find_in_pairs(self, client, cameras, request.exposure_s, watch)
        with watch.step("triangulate_s"):
            findings = spots[0].finding, spots[1].finding
            stereo: StereoFinding = self.tool("tool_triangulate")((cameras[0], cameras[1]), findings)
        remark = "" if stereo.point is None else self.rig.book.remark(cameras)
        return SpotFindStereoResult(spots, stereo, {**timing, **watch.report()}, remark)
