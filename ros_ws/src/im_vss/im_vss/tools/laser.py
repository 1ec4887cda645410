"""Tools of the laser: point the laser, find the spot or line in images, and calibrate the scanner."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from im_cell.frames import Frame, FrameSet
from im_cell.link import LaserBeam
from im_core.errors import DataError
from im_vss.laser.calibration import LaserCalibration, LaserSpot, calibrate
from im_vss.laser.line import FARTHEST_M, line_peaks, upright
from im_vss.managers import VisionClient
from im_vss.spot import SpotFinding, SpotFit, find_spot
from im_vss.tools.tool import Tool


class ToolLaserPoint(Tool):
    """Computes the mirrors' angles for a target, and drives the scanner there."""

    name: ClassVar[str] = "tool_laser_point"

    def angles_to(self, target: NDArray[np.float64]) -> tuple[float, float]:
        """Return the angles of the beam to a point of the world, shape (3,) [m], by the scanner's calibration [rad].

        Raises:
            DataError: The point is not finite, or behind the scanner.
            StateError: There is no scanner.
        """
        first, second = self.rig.scanner.book.entry.model.angles_to(target).tolist()
        return first, second

    def __call__(self, client: VisionClient, angles: tuple[float, float], on: bool) -> tuple[LaserBeam, int]:
        """Point the beam; the beam stays at the target.

        Args:
            client: Who asks.
            angles: Of the mirrors [rad].
            on: Whether the beam is lit.

        Returns:
            What the scanner's sensors say, and the testbed time then [ns].

        Raises:
            ImError: A mirror would turn too far, or the scanner is not there.
        """
        beam = LaserBeam(*angles, power=self.rig.settings.laser.spot_power if on else 0.0)
        with self.modules.use("vm_laser", client) as (vm_laser, lease):
            reading: tuple[LaserBeam, int] = vm_laser.drive(lease, beam)
        return reading


class ToolLaserSnap(Tool):
    """Points the laser and takes a pair of frames, holding both hardware's leases: nobody moves a mirror in between.

    The lease of the laser may be over when the cameras are free, or when they have exposed: then there are no frames.
    """

    name: ClassVar[str] = "tool_laser_snap"

    def __call__(
        self, client: VisionClient, cameras: tuple[str, ...], beam: LaserBeam | None, exposure_s: float
    ) -> tuple[FrameSet, LaserBeam]:
        """Expose a frame without the laser and one with laser, all cameras together, wrist lights strobed off.

        Args:
            client: Who asks.
            cameras: Names of the cameras.
            beam: What to show, dark afterwards; None: as the scanner is, and stays.
            exposure_s: Length of each exposure [s]; 0: the one that is set.

        Returns:
            The frames, and what the scanner's sensors said.

        Raises:
            ImError: A camera is unknown, the exposure out of range, a mirror would turn too far, or the hardware does
                not deliver.
        """
        order = self.rig.order(cameras, exposure_s, (True, True), (True, False))
        with self.modules.use("vm_laser", client) as (vm_laser, laser_lease):
            try:
                if beam is None:
                    reading: LaserBeam = vm_laser.reading(laser_lease)
                else:
                    reading, _ = vm_laser.drive(laser_lease, beam)
                with self.modules.use("vm_snap", client) as (vm_snap, snap_lease):
                    laser_lease.check(vm_laser.name)
                    frames: FrameSet = vm_snap.snap(snap_lease, order)
                    laser_lease.check(vm_laser.name)
            finally:
                if beam is not None:
                    vm_laser.darken(beam)
        return frames, reading


class ToolLaserSpot(Tool):
    """Finds the spot in a pair of frames; a calculation, without a Vision Module."""

    name: ClassVar[str] = "tool_laser_spot"

    def __call__(self, off: Frame, on: Frame) -> SpotFinding:
        """The spot in the difference of two frames of one camera.

        Speckle is noise that the sensor's data sheet does not know: where the fit is worse than it says, the covariance
        is larger by as much.
        """
        settings = self.rig.settings
        finding = find_spot(on.image, off.image, on.controls.of(settings.sensor), settings.spot)
        spot = None if finding.spot is None else _with_speckle(finding.spot)
        return replace(finding, spot=spot, candidates=tuple(map(_with_speckle, finding.candidates)))


def _with_speckle(spot: SpotFit) -> SpotFit:
    return replace(spot, covariance=spot.covariance * max(1.0, spot.chi2_per_dof))


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
    """Tool for the line in a camera, the rays met with the laser's plane; without a Vision Module."""

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


class ToolLaserCalibrate(Tool):
    """A calculation, without a Vision Module."""

    name: ClassVar[str] = "tool_laser_calibrate"

    def __call__(self, cameras: Sequence[str], spots: Sequence[LaserSpot]) -> LaserCalibration:
        """Return the estimate from some spots, with the verdicts.

        Args:
            cameras: Names of those that saw the spots, in the order in which these were triangulated.
            spots: What they saw.
        """
        known = self.rig.book.covariance.of(cameras)
        return calibrate(self.rig.cell.scanner, spots, known, self.rig.settings.laser.calibration)
