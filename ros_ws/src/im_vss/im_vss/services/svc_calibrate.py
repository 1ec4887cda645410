"""Service that calibrates cameras from observations of the wrist light."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError
from im_vss.calibration import Calibration, CalibrationProblem, report_of, write_results
from im_vss.managers import VisionClient
from im_vss.services.service import Service

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SeenSpot:
    """Where a camera saw the light: centre, shape (2,) [px], and its covariance, shape (2, 2) [px^2]."""

    uv: Array
    covariance: Array


@dataclass(frozen=True)
class Observation:
    """One pose of the robot and what the cameras saw.

    Attributes:
        pose: Its name.
        position: Origin of the wrist frame in the world, shape (3,) [m].
        rotation: Rotation wrist -> world, shape (3, 3).
        position_covariance: Covariance of `position`, shape (3, 3) [m^2].
        spots: By camera; a camera that saw no light is left out.
    """

    pose: str
    position: Array
    rotation: Array
    position_covariance: Array
    spots: dict[str, SeenSpot]


@dataclass(frozen=True)
class CalibrateRequest:
    """What to calibrate.

    Attributes:
        cameras: Names of the cameras; they are estimated together.
        observations: What they saw.
        directory: Where plots and files go; None: nowhere.
        apply: Whether a good result becomes the cameras' calibration.
    """

    cameras: tuple[str, ...]
    observations: tuple[Observation, ...]
    directory: Path | None = None
    apply: bool = False


@dataclass(frozen=True)
class CalibrateResult:
    """The estimate, the report of it, whether it is now in use, and where plots and files went, if anywhere."""

    calibration: Calibration
    report: dict[str, Any]
    applied: bool
    directory: Path | None


class SvcCalibrate(Service):
    """Estimates intrinsics, lens and pose of cameras, and the light's offset in the wrist frame."""

    name: ClassVar[str] = "calibrate"

    def serve(self, client: VisionClient, request: CalibrateRequest) -> CalibrateResult:
        """Calibrate.

        Raises:
            ImError: A camera is unknown or moves with the arm, the observations do not determine the cameras, or the
                results cannot be written.
        """
        problem = self._problem(request)
        calibration: Calibration = self.tool("tool_calibrate")(problem)
        if request.directory is not None:
            write_results(request.directory, calibration, problem)
        applied = request.apply and calibration.success
        if applied:
            for estimate in calibration.cameras:
                self.rig.book.set_intrinsics(estimate.name, estimate.model)
                self.rig.book.set_pose(estimate.name, estimate.model)
        return CalibrateResult(calibration, report_of(calibration, problem), applied, request.directory)

    def _problem(self, request: CalibrateRequest) -> CalibrationProblem:
        """The observations in the solver's terms.

        Raises:
            ImError: A camera is unknown or moves with the arm, there is no observation, or one is malformed.
        """
        cameras = self.rig.settings.check_cameras(request.cameras)
        entries = [self.rig.book[camera] for camera in cameras]
        for entry in entries:
            if entry.parent != "world":
                raise DataError(f"{entry.name} moves with {entry.parent}: only fixed cameras are calibrated")
        observations = request.observations
        if not observations:
            raise DataError("there is no observation to calibrate from")
        offset = np.array(self.rig.cell.led.offset)
        spots = np.full((len(cameras), len(observations), 2), np.nan)
        covariances = np.tile(np.eye(2), (len(cameras), len(observations), 1, 1))
        for c, camera in enumerate(cameras):
            for i, observation in enumerate(observations):
                seen = observation.spots.get(camera)
                if seen is not None:
                    spots[c, i], covariances[c, i] = seen.uv, seen.covariance
        return CalibrationProblem(
            camera_names=cameras,
            image_sizes=tuple((entry.model.width, entry.model.height) for entry in entries),
            positions=np.array([o.position + o.rotation @ offset for o in observations]),
            position_covariances=np.array([o.position_covariance for o in observations]),
            wrist_rotations=np.array([o.rotation for o in observations]),
            spots=spots,
            spot_covariances=covariances,
            led_offset_prior_sd=self.rig.settings.light.offset_prior_sd,
            led_offset_nominal=self.rig.cell.led.offset,
            pose_names=tuple(o.pose for o in observations),
        )
