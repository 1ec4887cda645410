"""Base of the Services that find features in one image of one camera."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from im_cell.frames import Frame
from im_core.stopwatch import Stopwatch
from im_vss.managers import VisionClient
from im_vss.services.service import VisionService
from im_vss.tools.region import WHOLE, Region
from im_vss.tools.tool_spot_disp import Seen

Fit = TypeVar("Fit")
Gates = TypeVar("Gates")


@dataclass(frozen=True)
class FeatureFindRequest:
    """Where to look for features; 0 stands for what is configured.

    Attributes:
        camera: Name of the camera.
        exposure_s: Length of the exposure [s].
        region: Part of the image.
    """

    camera: str
    exposure_s: float = 0.0
    region: Region = WHOLE


class FeatureFind(VisionService):
    """Takes an image, shows it, and finds something in it."""

    def find(
        self,
        client: VisionClient,
        request: FeatureFindRequest,
        tool: Callable[[Frame, Region, Gates], Sequence[Fit]],
        gates: Gates,
        mark: Callable[[tuple[Fit, ...]], Seen],
    ) -> tuple[tuple[Fit, ...], int, dict[str, float]]:
        """Find features.

        Args:
            client: Who asks.
            request: Where to look.
            tool: What finds them, called with image, region and gates.
            gates: What is to be found.
            mark: Makes of the features what the display shows.

        Returns:
            The features, testbed time of the exposure [ns], and where the time went, by step [s].

        Raises:
            ImError: The camera is unknown, a value out of range, or the camera does not deliver.
        """
        region, watch = self.region(request.camera, request.region), Stopwatch()
        images = self.shown(client, (request.camera,), request.exposure_s, watch)
        (frame,) = images.frames[request.camera]
        with watch.step("find_s"):
            found = tuple(tool(frame, region, gates))
        with watch.step("display_s"):
            self.tool("tool_spot_disp")(client, {request.camera: mark(found)})
        return found, frame.stamp_ns, {**images.timing, **watch.report()}
