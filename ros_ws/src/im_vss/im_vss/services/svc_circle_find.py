"""Service that finds circles."""

from dataclasses import dataclass
from typing import ClassVar

from im_vss.edges import EllipseFit
from im_vss.managers import VisionClient
from im_vss.services.feature_find import FeatureFind, FeatureFindRequest
from im_vss.tools.tool_spot_disp import Circles


@dataclass(frozen=True)
class CircleFindRequest(FeatureFindRequest):
    """Where to look for circles; 0 stands for what is configured.

    Attributes:
        radius_min: Smallest radius [px].
        radius_max: Largest radius [px].
    """

    radius_min: float = 0.0
    radius_max: float = 0.0


@dataclass(frozen=True)
class CircleFindResult:
    """The circles, clearest first, testbed time of the exposure [ns], and where the time went, by step [s]."""

    found: tuple[EllipseFit, ...]
    stamp_ns: int
    timing: dict[str, float]


class SvcCircleFind(FeatureFind):
    """Takes an image, shows it, and finds circles in it."""

    name: ClassVar[str] = "circle_find"

    def serve(self, client: VisionClient, request: CircleFindRequest) -> CircleFindResult:
        """Find circles.

        Raises:
            ImError: The camera is unknown, a value out of range, or the camera does not deliver.
        """
        tool = self.tool("tool_circle_find")
        gates = tool.gates(request.radius_min, request.radius_max)
        return CircleFindResult(*self.find(client, request, tool, gates, Circles))
