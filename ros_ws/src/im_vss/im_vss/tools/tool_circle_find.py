"""Tool that computes where circles are."""

import math
from dataclasses import replace
from typing import ClassVar

from im_cell.frames import Frame
from im_core.errors import DataError
from im_vss.edges import CircleGates, EllipseFit, find_circles
from im_vss.tools.region import Region, cut
from im_vss.tools.tool import Tool


class ToolCircleFind(Tool):
    """Finds circles in an image; a calculation, without a Vision Module."""

    name: ClassVar[str] = "tool_circle_find"

    def gates(self, radius_min: float, radius_max: float) -> CircleGates:
        """What is a circle, with radii between two limits [px]; 0: as configured.

        Raises:
            DataError: The range of radii is none.
        """
        gates = self.rig.settings.circles
        low, high = radius_min or gates.radius_min, radius_max or gates.radius_max
        if not 3.0 <= low <= high < math.inf:
            raise DataError(f"radii from {low:g} to {high:g} px: it must be at least 3, and the first not the larger")
        return gates.model_copy(update={"radius_min": low, "radius_max": high})

    def __call__(self, frame: Frame, region: Region, gates: CircleGates) -> list[EllipseFit]:
        """The circles in a part of an image; those with the clearest contrast first.

        Args:
            frame: The image.
            region: The part, which lies in the image.
            gates: What is a circle.
        """
        image, u, v = cut(frame.image, region)
        sensor = frame.controls.of(self.rig.settings.sensor)
        found = find_circles(image, sensor, gates)
        return [replace(circle, u=circle.u + u, v=circle.v + v) for circle in found]
