"""Tool that triangulates a laser line with two cameras."""

from typing import ClassVar

import numpy as np

from im_cell.frames import Frame
from im_cell.link import LaserBeam
from im_core.errors import DataError
from im_vss.laser.line import line_peaks, match_lines, upright
from im_vss.tools.tool import Tool
from im_vss.tools.tool_laser_line import LinePoints


class ToolLineStereo(Tool):
    """Finds the line in two cameras and matches them along epipolar lines: the scanner need not be calibrated."""

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
