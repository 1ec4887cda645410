"""Find circles and lines in an image, and a line in space from two images."""

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np

from im_cell.frames import Frame
from im_cell.link import LaserBeam
from im_core.errors import DataError
from im_vss.edges import CircleGates, EllipseFit, LineFit, LineGates, find_circles, find_lines
from im_vss.laser.line import line_peaks, match_lines, upright
from im_vss.tools.laser import LinePoints
from im_vss.tools.spot import Region, cut
from im_vss.tools.tool import Tool


class ToolCircleFind(Tool):
    """Finds circles in an image; a calculation, without a Vision Module."""

    name: ClassVar[str] = "tool_circle_find"

    def gates(self, radius_min: float, radius_max: float) -> CircleGates:
        """Return the limits of a circle, with radii between two limits [px]; 0: as configured.

        Raises:
            DataError: The range of radii is none.
        """
        gates = self.rig.settings.circles
        low, high = radius_min or gates.radius_min, radius_max or gates.radius_max
        if not 3.0 <= low <= high < math.inf:
            raise DataError(f"radii from {low:g} to {high:g} px: it must be at least 3, and the first not the larger")
        return gates.model_copy(update={"radius_min": low, "radius_max": high})

    def __call__(self, frame: Frame, region: Region, gates: CircleGates) -> list[EllipseFit]:
        """Return the circles in a part of an image, the clearest contrast first.

        Args:
            frame: The image.
            region: The part, which lies in the image.
            gates: What is a circle.
        """
        image, u, v = cut(frame.image, region)
        sensor = frame.controls.of(self.rig.settings.sensor)
        found = find_circles(image, sensor, gates)
        return [replace(circle, u=circle.u + u, v=circle.v + v) for circle in found]


_SHORTEST_PX = 12.0


class ToolLineFind(Tool):
    """Finds straight edges in an image; a calculation, without a Vision Module."""

    name: ClassVar[str] = "tool_line_find"

    def gates(self, length_min: float) -> LineGates:
        """Return the limits of a line, with a smallest length [px]; 0: as configured.

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


class ToolLineStereo(Tool):
    """Tool for a line in two cameras, matched along epipolar lines: the scanner need not be calibrated."""

    name: ClassVar[str] = "tool_line_stereo"

    def __call__(self, pairs: tuple[tuple[Frame, ...], tuple[Frame, ...]], beam: LaserBeam) -> LinePoints:
        """The line in the world.

        Args:
            pairs: Of each of two fixed cameras, a frame with the laser strobed off and one with it.
            beam: What the scanner's sensors said.

        Raises:
            StateError: There is no scanner.
        """
        settings, laser = self.rig.settings, self.rig.scanner.book.entry.model
        models = self.rig.book[pairs[0][1].camera].model, self.rig.book[pairs[1][1].camera].model
        peaks = [
            line_peaks(
                on.image, off.image, upright(model, laser, beam), on.controls.of(settings.sensor), settings.laser.line
            )
            for model, (off, on) in zip(models, pairs, strict=True)
        ]
        first, second = peaks
        if len(second.pixels) < 2:
            cause = {"no match in the other camera": len(first.pixels)} if len(first.pixels) else {}
            return LinePoints(np.zeros((0, 3)), np.zeros(0), {**first.rejected, **cause})
        try:
            matches = match_lines(models, first.pixels, second.pixels)
        except DataError:
            cause = {"outside of the lens model": len(first.pixels)}
            return LinePoints(np.zeros((0, 3)), np.zeros(0), {**first.rejected, **cause})
        rejected = {**first.rejected, **matches.rejected}
        return LinePoints(matches.points, first.brightness[matches.places], rejected)
