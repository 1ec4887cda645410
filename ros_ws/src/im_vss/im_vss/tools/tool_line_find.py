"""Tool that computes where straight edges are."""

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np

from im_cell.frames import Frame
from im_core.errors import DataError
from im_vss.edges import LineFit, LineGates, find_lines
from im_vss.tools.region import Region, cut
from im_vss.tools.tool import Tool

_SHORTEST_PX = 12.0


class ToolLineFind(Tool):
    """Finds straight edges in an image; a calculation, without a Vision Module."""

    name: ClassVar[str] = "tool_line_find"

    def gates(self, length_min: float) -> LineGates:
        """What is a line, with a smallest length [px]; 0: as configured.

        Raises:
            DataError: It is too short.
        """
        gates = self.rig.settings.lines
        length = length_min or gates.length
        if not _SHORTEST_PX <= length < math.inf:
            raise DataError(f"a line of {length:g} px cannot be fitted, at least {_SHORTEST_PX:g} px are needed")
        return gates.model_copy(update={"length": length})

    def __call__(self, frame: Frame, region: Region, gates: LineGates) -> list[LineFit]:
        """The straight edges in a part of an image, in undistorted pixels, longest first.

        Args:
            frame: The image.
            region: The part, which lies in the image.
            gates: What is a line.
        """
        image, u, v = cut(frame.image, region)
        model = self.rig.book[frame.camera].model
        shift = np.array([[0.0, 0.0, u], [0.0, 0.0, v], [0.0, 0.0, 0.0]])
        part = replace(model, width=image.shape[1], height=image.shape[0], K=model.K - shift)
        sensor = frame.controls.of(self.rig.settings.sensor)
        found = find_lines(image, part, sensor, gates, self.rig.book.covariance.of([frame.camera]))
        corner = np.array([u, v])
        return [replace(line, start=line.start + corner, end=line.end + corner) for line in found]
