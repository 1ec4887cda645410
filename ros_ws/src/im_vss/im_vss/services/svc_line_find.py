"""Service that finds straight edges."""

from dataclasses import dataclass
from typing import ClassVar

from im_vss.edges import LineFit
from im_vss.managers import VisionClient
from im_vss.services.service import Service
from im_vss.stopwatch import Stopwatch
from im_vss.tools.region import WHOLE, Region
from im_vss.tools.tool_spot_disp import Lines

_AS_DRAWN = "{} is not calibrated: its lens is taken as drawn, without distortion; long edges are bent or in pieces"


@dataclass(frozen=True)
class LineFindRequest:
    """Where to look for straight edges; 0 stands for what is configured.

    Attributes:
        camera: Name of the camera.
        exposure_s: Length of the exposure [s].
        region: Part of the image.
        length_min: Shortest line [px].
    """

    camera: str
    exposure_s: float = 0.0
    region: Region = WHOLE
    length_min: float = 0.0


@dataclass(frozen=True)
class LineFindResult:
    """What was found.

    Attributes:
        found: The lines, longest first.
        stamp_ns: Testbed time of the exposure [ns].
        remark: What a user must know to trust the lines; empty: nothing.
        timing: Where the time went, by step [s].
    """

    found: tuple[LineFit, ...]
    stamp_ns: int
    remark: str
    timing: dict[str, float]


class SvcLineFind(Service):
    """Takes an image, shows it, and finds straight edges in it."""

    name: ClassVar[str] = "line_find"

    def serve(self, client: VisionClient, request: LineFindRequest) -> LineFindResult:
        """Find straight edges.

        Raises:
            ImError: The camera is unknown, a value out of range, or the camera does not deliver.
        """
        tool, region = self.tool("tool_line_find"), self.region(request.camera, request.region)
        gates = tool.gates(request.length_min)
        watch = Stopwatch()
        images = self.shown(client, (request.camera,), request.exposure_s, watch)
        (frame,) = images.frames[request.camera]
        with watch.step("find_s"):
            found = tool(frame, region, gates)
        with watch.step("display_s"):
            self.tool("tool_spot_disp")(client, {request.camera: Lines(tuple(found))})
        remark = "" if self.rig.book[request.camera].calibrated else _AS_DRAWN.format(request.camera)
        return LineFindResult(tuple(found), frame.stamp_ns, remark, {**images.timing, **watch.report()})
