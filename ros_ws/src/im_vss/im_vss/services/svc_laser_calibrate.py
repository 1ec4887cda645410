"""Service that calibrates the laser scanner."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from im_cell.link import LaserBeam
from im_core.errors import ConfigError, DataError
from im_vss.laser.calibration import LaserCalibration, LaserSpot
from im_vss.laser.scanner import check_beam
from im_vss.managers import VisionClient
from im_vss.services.laser_spots import fixed_cameras, look, why_not
from im_vss.services.service import VisionService


@dataclass(frozen=True)
class LaserCalibrateRequest:
    """Cameras, and angles of the mirrors for each spot [rad]; none: the grid of the settings."""

    cameras: tuple[str, ...]
    mirror1: tuple[float, ...] = ()
    mirror2: tuple[float, ...] = ()
    apply: bool = False


@dataclass(frozen=True)
class LaserCalibrateResult:
    """The estimate, spots that were not used with the cause, and the file; None: it was not applied.

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
        beams = [check_beam(beam, self.rig.cell.laser) for beam in self._beams(request)]
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
