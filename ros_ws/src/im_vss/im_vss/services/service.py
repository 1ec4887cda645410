"""Base of all Services."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

from im_cell.frames import FrameSet
from im_core.stopwatch import Stopwatch
from im_vss.managers import VisionClient
from im_vss.rig import Rig
from im_vss.tools import Tool
from im_vss.tools.spot import Region, check_region


class VisionService(ABC):
    """Vision operation; stateless, so any number of clients may use the operation at once."""

    name: ClassVar[str]

    def __init__(self, rig: Rig, tools: Mapping[str, Tool]) -> None:
        """Work on `rig` with `tools`, by name."""
        self.rig = rig
        self._tools = dict(tools)

    def tool(self, name: str) -> Any:
        """Return the Tool of a name, callable."""
        return self._tools[name]

    def shown(
        self, client: VisionClient, cameras: tuple[str, ...], exposure_s: float, watch: Stopwatch, count: int = 1
    ) -> FrameSet:
        """Take images of each camera, with the lights unchanged, and show them on the camera's display.

        Raises:
            ImError: A camera is unknown, the exposure out of range, or the cameras do not deliver.
        """
        with watch.step("snap_s"):
            images: FrameSet = self.tool("tool_snap")(client, cameras, exposure_s, (False,) * count)
        with watch.step("display_s"):
            self.tool("tool_image_disp")(client, images)
        return images

    def region(self, camera: str, region: Region) -> Region:
        """Return a part of the images of a camera.

        Raises:
            ImError: The camera is unknown, or its images have no such part.
        """
        self.rig.settings.check_cameras((camera,))
        model = self.rig.book[camera].model
        return check_region(region, model.width, model.height)

    @abstractmethod
    def serve(self, client: VisionClient, request: Any) -> Any:
        """Carry out a request.

        Returns:
            The Service's own result type.

        Raises:
            ImError: It cannot be done; the message says why.
        """
