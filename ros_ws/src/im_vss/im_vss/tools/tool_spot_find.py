"""Tool that computes where the light spot is."""

from typing import ClassVar

from im_vss.frames import Frame
from im_vss.spot import Finding, find_spot
from im_vss.tools.tool import Tool


class ToolSpotFind(Tool):
    """Finds the light in a pair of frames; a calculation, without a Vision Module (paper: toolSpotFind)."""

    name: ClassVar[str] = "tool_spot_find"

    def __call__(self, off: Frame, on: Frame) -> Finding:
        """The spot in the difference of two frames of one camera.

        Args:
            off: Frame with the lights strobed off.
            on: Frame with the lights as commanded.
        """
        return find_spot(on.image, off.image, self.rig.settings.sensor, self.rig.settings.spot)
