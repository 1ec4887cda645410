"""Service that finds straight edges."""

from dataclasses import dataclass
from typing import ClassVar

from im_vss.edges import LineFit
from im_vss.managers import VisionClient
from im_vss.services.service import Service
from im_vss.services.stopwatch import Stopwatch
from im_vss.tools.region import WHOLE, Region


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
    """The lines, longest first, testbed time of the exposure [ns], and where the time went, by step [s]."""

    found: tuple[LineFit, ...]
    stamp_ns: int
    timing: dict[str, float]


class SvcLineFind(Service):
    """Takes an image, shows it, and finds straight edges in it."""

    name: ClassVar[str] = "line_find"

    def serve(self, client: VisionClient, request: LineFindRequest) -> LineFindResult:
        """Find straight edges.

        Raises:
            ImError: The camera is unknown, a value out of range, or the camera does not deliver.
        """
        watch = Stopwatch()
        images = self.shown(client, (request.camera,), request.exposure_s, watch)
        (frame,) = images.frames[request.camera]
        with watch.step("find_s"):
            found = self.tool("tool_line_find")(frame, request.region, request.length_min)
        return LineFindResult(tuple(found), frame.stamp_ns, {**images.timing, **watch.report()})
