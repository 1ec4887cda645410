"""Service that finds straight edges."""

from dataclasses import dataclass
from typing import ClassVar

from im_vss.edges import LineFit
from im_vss.managers import VisionClient
from im_vss.services.feature_find import FeatureFind, FeatureFindRequest
from im_vss.tools.tool_spot_disp import Lines

_AS_DRAWN = "{} is not calibrated: its lens is taken as drawn, without distortion; long edges are bent or in pieces"


@dataclass(frozen=True)
class LineFindRequest(FeatureFindRequest):
    """Where to look for straight edges; 0 stands for what is configured.

    Attributes:
        length_min: Shortest line [px].
    """

    length_min: float = 0.0


@dataclass(frozen=True)
class LineFindResult:
    """What was found.

    Attributes:
        found: The lines, longest first.
        stamp_ns: Testbed time of the exposure [ns].
        timing: Where the time went, by step [s].
        remark: What a user must know to trust the lines; empty: nothing.
    """

    found: tuple[LineFit, ...]
    stamp_ns: int
    timing: dict[str, float]
    remark: str


class SvcLineFind(FeatureFind):
    """Takes an image, shows it, and finds straight edges in it."""

    name: ClassVar[str] = "line_find"

    def serve(self, client: VisionClient, request: LineFindRequest) -> LineFindResult:
        """Find straight edges.

        Raises:
            ImError: The camera is unknown, a value out of range, or the camera does not deliver.
        """
        tool = self.tool("tool_line_find")
        found = self.find(client, request, tool, tool.gates(request.length_min), Lines)
        book = self.rig.book
        remark = book.remark([request.camera]) if book[request.camera].calibrated else _AS_DRAWN.format(request.camera)
        return LineFindResult(*found, remark)
