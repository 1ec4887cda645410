"""Services of the laser scanner: point, spot in space, line scan, calibration."""

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from im_cell.frames import Frame, FrameSet
from im_cell.link import LaserBeam
from im_core.errors import ConfigError, DataError, StateError
from im_core.stopwatch import Stopwatch
from im_vss.laser.calibration import LaserCalibration, LaserSpot
from im_vss.laser.scanner import check_beam
from im_vss.managers import VisionClient
from im_vss.rig import Rig
from im_vss.services.service import VisionService
from im_vss.services.spot import CameraSpot
from im_vss.tools.laser import LinePoints
from im_vss.tools.spot import StereoFinding

Array = NDArray[np.float64]


def fixed_cameras(rig: Rig, names: tuple[str, ...], count: int | None) -> tuple[str, ...]:
    """Return the cameras of a request, if fixed to the world, calibrated, and enough.

    Raises:
        ImError: They are not.
    """
    cameras = rig.settings.check_cameras(names)
    if count is not None and len(cameras) != count:
        raise ConfigError(f"{count} cameras are needed, got {len(cameras)}: {', '.join(cameras)}")
    for camera in cameras:
        if rig.book[camera].parent != "world":
            raise DataError(f"{camera} moves with {rig.book[camera].parent}: fixed cameras are needed")
    nominal = [camera for camera in cameras if not rig.book[camera].calibrated]
    if nominal:
        raise StateError(f"not calibrated: {', '.join(nominal)}; no point in the world from these", cameras=nominal)
    return cameras


def look(
    service: VisionService, client: VisionClient, cameras: tuple[str, ...], beam: LaserBeam | None, exposure_s: float
) -> tuple[tuple[CameraSpot, ...], StereoFinding, LaserBeam, FrameSet]:
    """Return a pair of frames, the spot in each camera, and the point.

    Args:
        service: Whose Tools are called.
        client: Who asks.
        cameras: Two.
        beam: What to show; None: as the scanner is.
        exposure_s: Length of an exposure [s]; 0: the one that is set.

    Returns:
        What each camera saw, what follows from it, what the scanner's sensors said, and the frames.

    Raises:
        ImError: The hardware does not deliver, or a mirror would turn too far.
    """
    images: FrameSet
    images, reading = service.tool("tool_laser_snap")(client, cameras, beam, exposure_s)
    findings = [service.tool("tool_laser_spot")(*images.frames[camera]) for camera in cameras]
    stereo: StereoFinding = service.tool("tool_triangulate")((cameras[0], cameras[1]), tuple(findings))
    spots = tuple(
        CameraSpot(camera, images.frames[camera][1].stamp_ns, finding)
        for camera, finding in zip(cameras, findings, strict=True)
    )
    return spots, stereo, reading, images


def why_not(rig: Rig, spots: tuple[CameraSpot, ...], stereo: StereoFinding, beam: LaserBeam) -> str:
    """Return the causes of a missing point, one clause for each camera without the spot; empty for a point.

    One camera's spot and the beam say where the other would see it.
    """
    if stereo.point is not None:
        return ""
    if beam.power <= 0.0:
        return "the laser is not lit"
    missing = [spot for spot in spots if not spot.finding.candidates]
    if len(missing) == len(spots):
        names = " and ".join(spot.camera for spot in spots)
        return f"seen by neither {names}: the beam ends out of their sight, hidden from them, or on something too dark"
    if not missing:
        return stereo.cause
    (lacking,), (seeing,) = missing, [spot for spot in spots if spot.finding.candidates]
    try:
        place = _beam_meets(rig, seeing, beam)
    except DataError as error:
        return f"{lacking.camera}: {lacking.finding.cause}; {seeing.camera}: {error.message}"
    model = rig.book[lacking.camera].model
    uv = model.project(place)
    if np.isnan(uv).any():
        return f"out of sight of {lacking.camera}: it would be behind it"
    where = f"it would be at ({uv[0]:.0f}, {uv[1]:.0f}) px"
    if not bool(model.contains(uv)):
        return f"out of sight of {lacking.camera}: {where}"
    return f"{lacking.camera}: hidden, or too dark: {where}; {lacking.finding.cause}"


def _beam_meets(rig: Rig, seeing: CameraSpot, beam: LaserBeam) -> Array:
    """Return the point of the beam at the spot of one camera, shape (3,) [m].

    Raises:
        DataError: The camera's lens model cannot be inverted there.
    """
    model, spot = rig.book[seeing.camera].model, seeing.finding.candidates[0]
    starts, ways = rig.scanner.book.entry.model.rays([beam.mirror1, beam.mirror2])
    ray = model.ray([spot.u, spot.v])
    cosine = float(ray @ ways)
    between = starts - model.position
    distance = (float(between @ ray) * cosine - float(between @ ways)) / max(1.0 - cosine**2, 1e-12)
    return np.asarray(starts + distance * ways)


@dataclass(frozen=True)
class LaserPointRequest:
    """Point the beam to angles of the mirrors [rad], or, if given, to a point in the world, shape (3,) [m]."""

    angles: tuple[float, float]
    target: NDArray[np.float64] | None
    on: bool


@dataclass(frozen=True)
class LaserPointResult:
    """Readings of the scanner's sensors, testbed time then [ns], and whether the scanner is calibrated."""

    beam: LaserBeam
    stamp_ns: int
    calibrated: bool


class SvcLaserPoint(VisionService):
    """Service for pointing: the beam stays in place until the next request."""

    name: ClassVar[str] = "laser_point"

    def serve(self, client: VisionClient, request: LaserPointRequest) -> LaserPointResult:
        """Point.

        Raises:
            ImError: The target is behind the scanner, a mirror would turn too far, or the scanner is not there.
        """
        tool = self.tool("tool_laser_point")
        angles = request.angles if request.target is None else tool.angles_to(request.target)
        beam, stamp_ns = tool(client, angles, request.on)
        return LaserPointResult(beam, stamp_ns, self.rig.scanner.book.entry.calibrated)


@dataclass(frozen=True)
class LaserSpot3dRequest:
    """Request for the end of the beam at some angles of the mirrors [rad]; None: the present beam."""

    cameras: tuple[str, ...]
    angles: tuple[float, float] | None
    exposure_s: float = 0.0


@dataclass(frozen=True)
class LaserSpot3dResult:
    """Finding of each camera, the point, the readings of the scanner's sensors, and the times of the steps [s].

    `remark` is what a user must know to trust the covariance; empty: nothing.
    """

    spots: tuple[CameraSpot, ...]
    stereo: StereoFinding
    beam: LaserBeam
    timing: dict[str, float]
    remark: str


class SvcLaserSpot3d(VisionService):
    """Service for a spot in space: points the beam, takes frames without and with beam, and triangulates the spot."""

    name: ClassVar[str] = "laser_spot_3d"

    def serve(self, client: VisionClient, request: LaserSpot3dRequest) -> LaserSpot3dResult:
        """Find the spot.

        Raises:
            ImError: The cameras are not two that are fixed and calibrated, a mirror would turn too far, or the
                hardware does not deliver. A spot that is not found is no error: the finding says why.
        """
        cameras = fixed_cameras(self.rig, request.cameras, 2)
        watch = Stopwatch()
        power = self.rig.settings.laser.spot_power
        beam = None if request.angles is None else LaserBeam(*request.angles, power=power)
        with watch.step("look_s"):
            spots, stereo, reading, images = look(self, client, cameras, beam, request.exposure_s)
        with watch.step("display_s"):
            self.tool("tool_image_disp")(client, images)
            self.tool("tool_spot_disp")(client, {spot.camera: spot.finding for spot in spots})
        stereo = replace(stereo, cause=why_not(self.rig, spots, stereo, reading))
        remark = "" if stereo.point is None else self.rig.book.remark(cameras)
        return LaserSpot3dResult(spots, stereo, reading, {**images.timing, **watch.report()}, remark)


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
    """Result of a scan.

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
    """Service for structured light: planes of light met with rays of cameras, or lines matched between two cameras."""

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
        power = self.rig.settings.laser.line_power * half / self.rig.cell.scanner.range
        sweep = np.linspace(*request.sweep, request.lines).tolist()
        beams = [check_beam(LaserBeam(middle, mirror2, half, power), self.rig.cell.scanner) for mirror2 in sweep]
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


@dataclass(frozen=True)
class LaserCalibrateRequest:
    """Cameras, and angles of the mirrors for each spot [rad]; none: the grid of the settings."""

    cameras: tuple[str, ...]
    mirror1: tuple[float, ...] = ()
    mirror2: tuple[float, ...] = ()
    apply: bool = False


@dataclass(frozen=True)
class LaserCalibrateResult:
    """The estimate, unused spots with the causes, and the file; None: the estimate was not applied.

    `remark` is what a user must know to trust the covariance; empty: nothing.
    """

    calibration: LaserCalibration
    rejected: tuple[str, ...]
    file: Path | None
    remark: str


class SvcLaserCalibrate(VisionService):
    """Looks at spots at many angles with two cameras, and estimates the scanner's pose and mirrors."""

    name: ClassVar[str] = "laser_calibrate"

    def serve(self, client: VisionClient, request: LaserCalibrateRequest) -> LaserCalibrateResult:
        """Calibrate.

        Raises:
            ImError: The cameras are not two that are fixed and calibrated, angles are out of range, too many or not in
                pairs, the hardware does not deliver, or the client gave up: the calibration is as before then. Too few
                spots are no error: the verdicts say so.
        """
        cameras = fixed_cameras(self.rig, request.cameras, 2)
        beams = [check_beam(beam, self.rig.cell.scanner) for beam in self._beams(request)]
        spots: list[LaserSpot] = []
        rejected: list[str] = []
        for beam in beams:
            seen, stereo, reading, _ = look(self, client, cameras, beam, 0.0)
            angles = np.array([reading.mirror1, reading.mirror2])
            if stereo.point is None:
                rejected.append(_told(angles, why_not(self.rig, seen, stereo, reading)))
            else:
                spots.append(LaserSpot(angles, stereo.point))
        calibration: LaserCalibration = self.tool("tool_laser_calibrate")(cameras, spots)
        for spot, used, off in zip(spots, calibration.used, calibration.off, strict=True):
            if not used:
                rejected.append(_told(spot.angles, f"{off:.1f} standard deviations off its beam"))
        file = None
        if request.apply and not calibration.verdicts:
            client.commit()
            file = self.rig.scanner.book.set(calibration.model, calibration.covariance)
        return LaserCalibrateResult(calibration, tuple(rejected), file, self.rig.book.remark(cameras))

    def _beams(self, request: LaserCalibrateRequest) -> list[LaserBeam]:
        settings = self.rig.settings.laser
        if len(request.mirror1) != len(request.mirror2):
            raise DataError(f"{len(request.mirror1)} angles of mirror 1 and {len(request.mirror2)} of mirror 2")
        pairs = list(zip(request.mirror1, request.mirror2, strict=True))
        if not pairs:
            first, second = (
                np.linspace(-settings.grid.range, settings.grid.range, count)
                for count in (settings.grid.mirror1, settings.grid.mirror2)
            )
            pairs = [(float(a), float(b)) for b in second for a in first]
        if len(pairs) > settings.most_spots:
            raise ConfigError(f"{len(pairs)} spots are more than {settings.most_spots}", spots=len(pairs))
        return [LaserBeam(first, second, power=settings.spot_power) for first, second in pairs]


def _told(angles: NDArray[np.float64], cause: str) -> str:
    return f"({angles[0]:.4f}, {angles[1]:.4f}) rad: {cause}"
