"""Service that scans surfaces with a laser line."""

from collections import Counter
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from im_cell.frames import Frame
from im_cell.link import LaserBeam
from im_core.errors import ConfigError, StateError
from im_core.stopwatch import Stopwatch
from im_vss.laser.scanner import check_beam
from im_vss.managers import VisionClient
from im_vss.services.laser_spots import fixed_cameras
from im_vss.services.service import VisionService
from im_vss.tools.tool_laser_line import LinePoints

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LineScanRequest:
    """Sweep lines.

    Attributes:
        cameras: Names of the cameras.
        span: Angles of mirror 1 between which each line is swept [rad].
        sweep: Angles of mirror 2 from the first line to the last [rad].
        lines: How many.
        exposure_s: Length of an exposure [s]; 0: the one that is set.
    """

    cameras: tuple[str, ...]
    span: tuple[float, float]
    sweep: tuple[float, float]
    lines: int
    exposure_s: float = 0.0


@dataclass(frozen=True)
class LineScanResult:
    """What a scan brought.

    Attributes:
        points: In the world, shape (n, 3) [m].
        brightness: Of each point, shape (n,) [DN].
        stamp_ns: Testbed time of the last exposure [ns].
        rejected: Places that gave no point, by cause.
        timing: Where the time went, by step [s].
    """

    points: Array
    brightness: Array
    stamp_ns: int
    rejected: dict[str, int]
    timing: dict[str, float]


class SvcLineScan(VisionService):
    """Structured light: planes of light met with the rays of the cameras, or lines matched between two of them."""

    name: ClassVar[str] = "line_scan"

    def serve(self, client: VisionClient, request: LineScanRequest) -> LineScanResult:
        """Scan.

        Raises:
            ImError: The cameras are not fixed and calibrated, the scanner is not calibrated and the cameras are not
                two, the angles or the number of lines are out of range, or the hardware does not deliver.
        """
        cameras = fixed_cameras(self.rig, request.cameras, None)
        most = self.rig.settings.laser.most_lines
        if not 1 <= request.lines <= most:
            raise ConfigError(f"{request.lines} lines are not between 1 and {most}", lines=request.lines)
        if not request.span[0] < request.span[1]:
            raise ConfigError(f"a line from {request.span[0]:g} to {request.span[1]:g} rad of mirror 1 has no length")
        if not self.rig.scanner.book.entry.calibrated and len(cameras) != 2:
            raise StateError(
                "the laser scanner is not calibrated, so its planes of light are not known: laser_calibrate, or scan "
                f"with two cameras, not {len(cameras)}"
            )
        watch = Stopwatch()
        middle, half = 0.5 * (request.span[0] + request.span[1]), 0.5 * (request.span[1] - request.span[0])
        power = self.rig.settings.laser.line_power * half / self.rig.cell.laser.range
        sweep = np.linspace(*request.sweep, request.lines).tolist()
        beams = [check_beam(LaserBeam(middle, mirror2, half, power), self.rig.cell.laser) for mirror2 in sweep]
        parts: list[LinePoints] = []
        rejected: Counter[str] = Counter()
        for beam in beams:
            with watch.step("snap_s"):
                images, reading = self.tool("tool_laser_snap")(client, cameras, beam, request.exposure_s)
            with watch.step("line_s"):
                seen = self._triangulate([images.frames[camera] for camera in cameras], reading)
            parts += seen
            for part in seen:
                rejected.update(part.rejected)
        stamp_ns = images.frames[cameras[0]][1].stamp_ns
        points = np.concatenate([part.points for part in parts])
        return LineScanResult(
            points, np.concatenate([part.brightness for part in parts]), stamp_ns, dict(rejected), watch.report()
        )

    def _triangulate(self, pairs: list[tuple[Frame, ...]], beam: LaserBeam) -> list[LinePoints]:
        """The line by each camera and the plane of light; with a scanner as drawn, by the two cameras alone."""
        if self.rig.scanner.book.entry.calibrated:
            return [self.tool("tool_laser_line")(off, on, beam) for off, on in pairs]
        return [self.tool("tool_line_stereo")(tuple(pairs), beam)]
