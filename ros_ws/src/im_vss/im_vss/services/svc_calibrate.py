"""Service that calibrates cameras from observations of the wrist light."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from im_calibration import Calibration, CalibrationProblem, KnownLengths, report_of, write_results
from im_cell.calibration_files import CameraPose
from im_cell.camera_covariance import CameraCovariance
from im_cell.camera_model import CameraModel
from im_core.errors import DataError, NotFoundError, StateError
from im_vss.managers import VisionClient
from im_vss.services.service import VisionService

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
class SeenLength:
    """Two lights at a known distance, and what the cameras saw of them.

    Attributes:
        length: Distance of the lights [m].
        standard_deviation: How well it is known [m].
        ends: Spots of the first and of the second light, by camera; a camera that saw none is left out.
    """

    length: float
    standard_deviation: float
    ends: tuple[dict[str, SeenSpot], dict[str, SeenSpot]]


@dataclass(frozen=True)
class CalibrateRequest:
    """What to calibrate.

    Attributes:
        cameras: Names of the cameras; they are estimated together.
        observations: What they saw.
        lengths: Known lengths that judge the robot's scale.
        directory: Where plots and files go; None: nowhere.
        apply: Whether a good result becomes the cameras' calibration.
    """

    cameras: tuple[str, ...]
    observations: tuple[Observation, ...]
    lengths: tuple[SeenLength, ...] = ()
    directory: Path | None = None
    apply: bool = False


@dataclass(frozen=True)
class CalibrateResult:
    """The estimate, the report of it, whether it is now in use, and where plots and files went, if anywhere."""

    calibration: Calibration
    report: dict[str, Any]
    applied: bool
    directory: Path | None


class SvcCalibrate(VisionService):
    """Estimates intrinsics, lens and pose of cameras, and the light's offset in the wrist frame."""

    name: ClassVar[str] = "calibrate"

    def serve(self, client: VisionClient, request: CalibrateRequest) -> CalibrateResult:
        """Calibrate.

        Raises:
            ImError: A camera is unknown, it is not known where the arm is that carries it, the observations do not
                determine the cameras, the solver did not become free in time, or the results cannot be written.
        """
        problem = self._problem(request)
        calibration: Calibration = self.tool("tool_calibrate")(client, problem)
        found = calibration.cameras if calibration.success else ()
        mounted: dict[str, CameraModel] = {}
        covariance = calibration.camera_covariance
        for estimate in found:
            mounted[estimate.name], covariance = self._on_its_mount(estimate.name, estimate.model, covariance)
        if request.directory is not None:
            poses = {name: CameraPose.of(self.rig.book[name].parent, model) for name, model in mounted.items()}
            rectified = self.rig.book.rectified(mounted)
            write_results(request.directory, calibration, problem, poses, rectified, covariance)
        applied = request.apply and calibration.success
        if applied:
            self.rig.book.set_cameras(mounted, covariance)
        return CalibrateResult(calibration, report_of(calibration, problem), applied, request.directory)

    def _on_its_mount(
        self, camera: str, model: CameraModel, covariance: CameraCovariance
    ) -> tuple[CameraModel, CameraCovariance]:
        """A camera of the world relative to the frame that it is fixed to, and how well all are known then.

        Raises:
            StateError: The camera is on an arm, and it is not known where that is.
        """
        parent = self.rig.book[camera].parent
        if parent == "world":
            return model, covariance
        mount = self.rig.mount(parent)
        if mount is None:
            raise StateError(f"{camera} is fixed to {parent}, and it is not known where that is")
        return fixed_to(model, *mount), covariance.on_mount(camera, model.R_cam_base @ mount[1])

    def _problem(self, request: CalibrateRequest) -> CalibrationProblem:
        """The observations in the solver's terms.

        Raises:
            ImError: A camera is unknown, there is no observation, or one is malformed.
        """
        cameras = self.rig.settings.check_cameras(request.cameras)
        entries = [self.rig.book[camera] for camera in cameras]
        observations = request.observations
        if not observations:
            raise DataError("there is no observation to calibrate from")
        offset = np.array(self.rig.cell.led.offset)
        spots, covariances = self._spots(cameras, [observation.spots for observation in observations])
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
            lengths=self._lengths(cameras, request.lengths) if request.lengths else None,
        )

    def _lengths(self, cameras: tuple[str, ...], lengths: tuple[SeenLength, ...]) -> KnownLengths:
        """The known lengths in the solver's terms.

        Raises:
            ImError: A camera is unknown, or a value is impossible.
        """
        spots, covariances = self._spots(cameras, [end for length in lengths for end in length.ends])
        return KnownLengths(
            np.array([each.length for each in lengths]),
            np.array([each.standard_deviation for each in lengths]),
            spots.reshape(len(cameras), len(lengths), 2, 2),
            covariances.reshape(len(cameras), len(lengths), 2, 2, 2),
        )

    def _spots(self, cameras: tuple[str, ...], seen: list[dict[str, SeenSpot]]) -> tuple[Array, Array]:
        """Spots of some cameras, NaN where not seen, shape (c, n, 2) [px]; covariances, shape (c, n, 2, 2) [px^2].

        Raises:
            NotFoundError: A spot is of a camera that is not known.
        """
        spots = np.full((len(cameras), len(seen), 2), np.nan)
        covariances = np.tile(np.eye(2), (len(cameras), len(seen), 1, 1))
        for i, by_camera in enumerate(seen):
            for camera, spot in by_camera.items():
                if camera in cameras:
                    c = cameras.index(camera)
                    spots[c, i], covariances[c, i] = spot.uv, spot.covariance
                elif camera not in self.rig.settings.cameras:
                    raise NotFoundError(kind="camera", name=camera, known=self.rig.settings.cameras)
        return spots, covariances


def fixed_to(camera: CameraModel, rotation: Array, origin: Array) -> CameraModel:
    """A camera with its pose relative to a frame instead of the world.

    Args:
        camera: The camera, its pose in the world.
        rotation: Rotation frame -> world, shape (3, 3).
        origin: Origin of the frame in the world, shape (3,) [m].
    """
    translation = camera.R_cam_base @ origin + camera.t_cam_base
    return replace(camera, R_cam_base=camera.R_cam_base @ rotation, t_cam_base=translation)
