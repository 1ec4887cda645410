"""Tool that computes where circles are."""

from dataclasses import replace
from typing import ClassVar

from im_core.errors import DataError
from im_vss.edges import EllipseFit, find_circles
from im_vss.frames import Frame
from im_vss.tools.region import Region, cut
from im_vss.tools.tool import Tool


class ToolCircleFind(Tool):
    """Finds circles in an image; a calculation, without a Vision Module."""

    name: ClassVar[str] = "tool_circle_find"

    def __call__(self, frame: Frame, region: Region, radius_min: float, radius_max: float) -> list[EllipseFit]:
        """The circles in a part of an image; those with the clearest contrast first.

        Args:
            frame: The image.
            region: The part.
            radius_min: Smallest radius [px]; 0: as configured.
            radius_max: Largest radius [px]; 0: as configured.

        Raises:
            DataError: The region is not in the image, or the range of radii is none.
        """
        gates = self.rig.settings.circles
        low, high = radius_min or gates.radius_min, radius_max or gates.radius_max
        if not 3.0 <= low <= high:
            raise DataError(f"radii from {low:g} to {high:g} px: it must be at least 3, and the first not the larger")
        image, u, v = cut(frame.image, region)
        sensor = frame.controls.of(self.rig.settings.sensor)
        found = find_circles(image, sensor, gates.model_copy(update={"radius_min": low, "radius_max": high}))
        return [replace(circle, u=circle.u + u, v=circle.v + v) for circle in found]
