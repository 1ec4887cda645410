"""Service that finds circles."""

from dataclasses import dataclass
from typing import ClassVar

from im_vss.edges import EllipseFit
from im_vss.managers import VisionClient
from im_vss.services.service import Service
from im_vss.stopwatch import Stopwatch
from im_vss.tools.region import WHOLE, Region
from im_vss.tools.tool_spot_disp import Circles


@dataclass(frozen=True)
class CircleFindRequest:
    """Where to look for circles; 0 stands for what is configured.

    Attributes:
        camera: Name of the camera.
        exposure_s: Length of the exposure [s].
        region: Part of the image.
        radius_min: Smallest radius [px].
        radius_max: Largest radius [px].
    """

    camera: str
    exposure_s: float = 0.0
    region: Region = WHOLE
    radius_min: float = 0.0
    radius_max: float = 0.0


@dataclass(frozen=True)
class CircleFindResult:
    """The circles, clearest first, testbed time of the exposure [ns], and where the time went, by step [s]."""

    found: tuple[EllipseFit, ...]
    stamp_ns: int
    timing: dict[str, float]


class SvcCircleFind(Service):
    """Takes an image, shows it, and finds circles in it."""

    name: ClassVar[str] = "circle_find"

    def serve(self, client: VisionClient, request: CircleFindRequest) -> CircleFindResult:
        """Find circles.

        Raises:
            ImError: The camera is unknown, a value out of range, or the camera does not deliver.
        """
        tool, region = self.tool("tool_circle_find"), self.region(request.camera, request.region)
        gates = tool.gates(request.radius_min, request.radius_max)
        watch = Stopwatch()
        images = self.shown(client, (request.camera,), request.exposure_s, watch)
        (frame,) = images.frames[request.camera]
        with watch.step("find_s"):
            found = tool(frame, region, gates)
        with watch.step("display_s"):
            self.tool("tool_spot_disp")(client, {request.camera: Circles(tuple(found))})
        return CircleFindResult(tuple(found), frame.stamp_ns, {**images.timing, **watch.report()})
