"""Service for the calibration of cameras from observations of the wrist light."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from im_calibration import (
    Calibration,
    CalibrationProblem,
    KnownLengths,
    report_of,
    write_observations,
    write_results,
)
from im_cell.calibration_files import CameraPose
from im_cell.camera_covariance import CameraCovariance
from im_cell.camera_model import CameraModel
from im_core.errors import DataError, NotFoundError
from im_core.processes.memory import give_back_freed
from im_vss.camera_book import CameraBook
from im_vss.camera_poses import Pose
from im_vss.managers import VisionClient
from im_vss.services.service import VisionService

Array = NDArray[np.float64]

#: Where a frame of the robot that carries a camera was at exposures, testbed times [ns]; StateError: that is not known.
Mount = Callable[[str, Sequence[int]], Pose]


@dataclass(frozen=True)
class SeenSpot:
    """Light in a camera: centre, shape (2,) [px], the covariance, shape (2, 2) [px^2], and the time [ns]."""

    uv: Array
    covariance: Array
    stamp_ns: int


@dataclass(frozen=True)
class Observation:
    """One pose of the robot and the cameras' findings.

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
    """Two lights at a known distance, and the cameras' findings of both.

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
    """Request for a calibration.

    Attributes:
        cameras: Names of the cameras; they are estimated together.
        observations: What they saw.
        lengths: Known lengths that judge the robot's scale.
        directory: Where plots and files go; None: nowhere.
        apply: Whether a result that can be used becomes the cameras' calibration.
    """

    cameras: tuple[str, ...]
    observations: tuple[Observation, ...]
    lengths: tuple[SeenLength, ...] = ()
    directory: Path | None = None
    apply: bool = False


@dataclass(frozen=True)
class CalibrateResult:
    """The estimate, the report, the use, and the folder of plots and files, if there is one."""

    calibration: Calibration
    report: dict[str, Any]
    applied: bool
    directory: Path | None


class SvcCalibrate(VisionService):
    """Estimates intrinsics, lens and pose of cameras, and the light's offset in the wrist frame."""

    name: ClassVar[str] = "calibrate"

    def serve(self, client: VisionClient, request: CalibrateRequest) -> CalibrateResult:
        """Calibrate the cameras that the observations determine; name the others in the report.

        The observations are written before anything is computed of them.

        Raises:
            ImError: A camera is unknown, it is not known where the arm that carries it was at the exposures, or it
                moved in between, the observations determine no camera, the solver did not become free in time, the
                results cannot be written, or the client gave up; the cameras' calibration is as before then.
        """
        cameras = self.rig.settings.check_cameras(request.cameras)
        models = {camera: self.rig.book[camera].model for camera in cameras}
        problem = problem_of(
            request,
            {camera: (model.width, model.height) for camera, model in models.items()},
            self.rig.cell.led.offset,
            self.rig.settings.light.offset_prior_sd,
            self.rig.settings.cameras,
        )
        if request.directory is not None:
            write_observations(request.directory, problem)
        calibration: Calibration = self.tool("tool_calibrate")(client, problem)
        for camera, residuals in zip(calibration.cameras, calibration.residuals, strict=True):
            self.rig.screen.residuals(camera.name, problem.spots[cameras.index(camera.name)], residuals)
        mounted, covariance = on_their_mounts(calibration, request, self.rig.book, self.rig.mounts.at)
        if request.directory is not None:
            write_calibration(request.directory, calibration, problem, self.rig.book, mounted, covariance)
        applied = request.apply and calibration.usable
        if applied:
            client.commit()
            self.rig.book.set_cameras(mounted, covariance)
        return CalibrateResult(calibration, report_of(calibration, problem), applied, request.directory)


def problem_of(
    request: CalibrateRequest,
    image_sizes: Mapping[str, tuple[int, int]],
    led_offset: tuple[float, float, float],
    led_offset_prior_sd: float,
    known: Collection[str],
) -> CalibrationProblem:
    """The observations of a request in the solver's terms.

    Args:
        request: Cameras, observations and known lengths.
        image_sizes: Width and height of the images of each camera of the request [px].
        led_offset: Nominal place of the light in the wrist frame [m].
        led_offset_prior_sd: How well each axis of it is known [m].
        known: Cameras that there are; others than those of the request may have spots.

    Raises:
        ImError: There is no observation, one is malformed, or of a camera that is not known.
    """
    observations, cameras = request.observations, request.cameras
    if not observations:
        raise DataError("there is no observation to calibrate from")
    offset = np.array(led_offset)
    spots, covariances = _spots(cameras, [observation.spots for observation in observations], known)
    return CalibrationProblem(
        camera_names=cameras,
        image_sizes=tuple(image_sizes[camera] for camera in cameras),
        positions=np.array([o.position + o.rotation @ offset for o in observations]),
        position_covariances=np.array([o.position_covariance for o in observations]),
        wrist_rotations=np.array([o.rotation for o in observations]),
        spots=spots,
        spot_covariances=covariances,
        led_offset_prior_sd=led_offset_prior_sd,
        led_offset_nominal=led_offset,
        pose_names=tuple(o.pose for o in observations),
        lengths=_lengths(cameras, request.lengths, known) if request.lengths else None,
    )


def on_their_mounts(
    calibration: Calibration, request: CalibrateRequest, book: CameraBook, mount: Mount
) -> tuple[dict[str, CameraModel], CameraCovariance]:
    """Return cameras that can be used, each relative to the parent frame, with the joint covariance.

    Raises:
        StateError: A camera is on an arm, and it is not known where that was when the camera was exposed, or it moved.
    """
    mounted: dict[str, CameraModel] = {}
    covariance = calibration.camera_covariance
    for camera in calibration.cameras if calibration.usable else ():
        model, parent = camera.model, book[camera.name].parent
        if parent != "world":
            seen = [seen.spots[camera.name] for seen in request.observations if camera.name in seen.spots]
            where = mount(parent, [spot.stamp_ns for spot in seen])
            model, covariance = fixed_to(model, *where), covariance.on_mount(camera.name, model.R_cam_base @ where[1])
        mounted[camera.name] = model
    return mounted, covariance


def write_calibration(
    directory: Path,
    calibration: Calibration,
    problem: CalibrationProblem,
    book: CameraBook,
    mounted: Mapping[str, CameraModel],
    covariance: CameraCovariance,
) -> None:
    """Write report, plots and camera files, with the cameras as given by :func:`on_their_mounts`.

    What drawing took is given back: tens of MiB in the arena of each thread that ever did this.

    Raises:
        DataError: The directory cannot be written.
    """
    poses = {name: CameraPose.of(book[name].parent, model) for name, model in mounted.items()}
    write_results(directory, calibration, problem, poses, book.rectified(mounted), covariance)
    give_back_freed()


def _lengths(cameras: tuple[str, ...], lengths: tuple[SeenLength, ...], known: Collection[str]) -> KnownLengths:
    """The known lengths in the solver's terms.

    Raises:
        ImError: A camera is unknown, or a value is impossible.
    """
    spots, covariances = _spots(cameras, [end for length in lengths for end in length.ends], known)
    return KnownLengths(
        np.array([each.length for each in lengths]),
        np.array([each.standard_deviation for each in lengths]),
        spots.reshape(len(cameras), len(lengths), 2, 2),
        covariances.reshape(len(cameras), len(lengths), 2, 2, 2),
    )


def _spots(cameras: tuple[str, ...], seen: list[dict[str, SeenSpot]], known: Collection[str]) -> tuple[Array, Array]:
    """Return spots of some cameras, NaN if unseen, shape (c, n, 2) [px]; covariances, shape (c, n, 2, 2) [px^2].

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
            elif camera not in known:
                raise NotFoundError(kind="camera", name=camera, known=known)
    return spots, covariances


def fixed_to(camera: CameraModel, rotation: Array, origin: Array) -> CameraModel:
    """Return a camera with the pose relative to a frame instead of the world.

    Args:
        camera: The camera, its pose in the world.
        rotation: Rotation frame -> world, shape (3, 3).
        origin: Origin of the frame in the world, shape (3,) [m].
    """
    translation = camera.R_cam_base @ origin + camera.t_cam_base
    return replace(camera, R_cam_base=camera.R_cam_base @ rotation, t_cam_base=translation)
