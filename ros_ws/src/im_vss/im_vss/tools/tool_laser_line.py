"""Tool that triangulates a laser line."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from im_cell.frames import Frame
from im_cell.link import LaserBeam
from im_core.errors import DataError
from im_vss.laser.line import FARTHEST_M, line_peaks, upright
from im_vss.tools.tool import Tool

Array = NDArray[np.float64]

_GRAZING = 0.02
_SPARE_RAD = 0.01


@dataclass(frozen=True)
class LinePoints:
    """Points of a line.

    Attributes:
        points: Places in the world, shape (n, 3) [m].
        brightness: Of each, shape (n,) [DN].
        rejected: Places that gave no point, by cause.
    """

    points: Array
    brightness: Array
    rejected: dict[str, int]


class ToolLaserLine(Tool):
    """Finds the line in a camera, and meets its rays with the laser's plane; without a Vision Module."""

    name: ClassVar[str] = "tool_laser_line"

    def __call__(self, off: Frame, on: Frame, beam: LaserBeam) -> LinePoints:
        """The line in the world.

        Args:
            off: Frame of a fixed camera with the laser strobed off.
            on: Frame with it.
            beam: What the scanner's sensors said.

        Raises:
            StateError: There is no scanner.
        """
        camera, laser = self.rig.book[on.camera].model, self.rig.scanner.book.entry.model
        settings = self.rig.settings
        sensor = on.controls.of(settings.sensor)
        peaks = line_peaks(on.image, off.image, upright(camera, laser, beam), sensor, settings.laser.line)
        rejected = dict(peaks.rejected)
        try:
            rays = camera.ray(peaks.pixels)
        except DataError:
            return LinePoints(
                np.zeros((0, 3)), np.zeros(0), {**rejected, "outside of the lens model": len(peaks.pixels)}
            )
        normal = laser.planes(beam.mirror2)
        slope = rays @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (laser.position - camera.position) @ normal / slope
        points = camera.position + distance[:, None] * rays
        grazing = np.abs(slope) < _GRAZING
        reach = (distance > 0.0) & (distance < FARTHEST_M)
        swept = np.zeros(len(points), dtype=np.bool_)
        near = ~grazing & reach & (((points - laser.position) @ laser.rotation)[:, 2] > 0.0)
        mirror1 = laser.angles_to(points[near])[:, 0]
        swept[near] = np.abs(mirror1 - beam.mirror1) <= beam.half_sweep + _SPARE_RAD
        causes = {"ray along the plane of light": grazing, "not on the swept line": ~grazing & ~swept}
        rejected.update({cause: int(which.sum()) for cause, which in causes.items() if which.any()})
        return LinePoints(points[swept], peaks.brightness[swept], rejected)
