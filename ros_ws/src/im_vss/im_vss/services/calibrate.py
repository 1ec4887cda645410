"""Service for the calibration of cameras from observations of the wrist light, or of a target on a wrist."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from im_calibration import (
    TARGET_NOISE,
    Calibration,
    CalibrationProblem,
    Observation,
    SeenLength,
    dataset_of,
    dataset_of_views,
    problem_of,
    problem_of_views,
    report_of,
    views_of,
    write_observations,
    write_results,
)
from im_calibration.targets.target import chessboard_of
from im_cell.calibration_files import CameraPose
from im_cell.camera_covariance import CameraCovariance
from im_cell.camera_model import CameraModel
from im_cell.robot import Cell
from im_core.processes.memory import give_back_freed
from im_vss.camera_book import CameraBook
from im_vss.camera_poses import Pose
from im_vss.managers import VisionClient
from im_vss.services.service import VisionService

Array = NDArray[np.float64]

#: Where a frame of the robot that carries a camera was at exposures, testbed times [ns]; StateError: that is not known.
Mount = Callable[[str, Sequence[int]], Pose]


@dataclass(frozen=True)
class CalibrateRequest:
    """Request for a calibration.

    Attributes:
        cameras: Names of the cameras; they are estimated together.
        observations: What they saw.
        lengths: Known lengths that judge the robot's scale.
        directory: Where plots and files go; None: nowhere.
        apply: Whether a result that can be used becomes the cameras' calibration.
        target: Name of the target of the cell in the observations; empty: they are of the light.
    """

    cameras: tuple[str, ...]
    observations: tuple[Observation, ...]
    lengths: tuple[SeenLength, ...] = ()
    directory: Path | None = None
    apply: bool = False
    target: str = ""


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
        sizes = {camera: (model.width, model.height) for camera, model in models.items()}
        dataset, problem = dataset_and_problem(
            replace(request, cameras=cameras), sizes, self.rig.cell, self.rig.settings.cameras
        )
        if request.directory is not None:
            write_observations(request.directory, dataset)
        calibration: Calibration = self.tool("tool_calibrate")(client, problem)
        for camera, residuals in zip(calibration.cameras, calibration.residuals, strict=True):
            self.rig.book.residuals[camera.name] = problem.spots[cameras.index(camera.name)], residuals
        mounted, covariance = on_their_mounts(calibration, request, self.rig.book, self.rig.mounts.at)
        if request.directory is not None:
            write_calibration(request.directory, calibration, problem, self.rig.book, mounted, covariance)
        applied = request.apply and calibration.usable
        if applied:
            client.commit()
            self.rig.book.set_cameras(mounted, covariance)
        return CalibrateResult(calibration, report_of(calibration, problem), applied, request.directory)


def dataset_and_problem(
    request: CalibrateRequest,
    sizes: Mapping[str, tuple[int, int]],
    cell: Cell,
    known: Collection[str],
    *,
    offset: tuple[tuple[float, float, float], float] | None = None,
    lens_model: str | None = None,
    noise_to_estimate: tuple[str, ...] = (),
) -> tuple[dict[str, Any], CalibrationProblem]:
    """Return the observations of a request as a data set, and in the solver's terms.

    Sizes are width and height of images [px]. None and () stand for the cell's light, and for usual lenses and noise.

    Raises:
        ImError: There is none, one is malformed, or the target is no chessboard of the cell or in too few of them.
    """
    lenses = None if lens_model is None else (lens_model,) * len(request.cameras)
    if request.target:
        views = views_of(request.cameras, request.observations, chessboard_of(cell, request.target), sizes, known)
        views = replace(views, lens_models=lenses or views.lens_models)
        noise = noise_to_estimate or TARGET_NOISE
        return dataset_of_views(views, noise), problem_of_views(views, noise)
    offset = offset or (cell.led.offset, cell.led.offset_prior_sd)
    problem = problem_of(
        request.cameras, request.observations, request.lengths, sizes, offset, known, cell.workspace_box
    )
    noise = noise_to_estimate or problem.noise_to_estimate
    problem = replace(problem, lens_models=lenses or problem.lens_models, noise_to_estimate=noise)
    return dataset_of(problem), problem


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
            found = [seen.views if request.target else seen.spots for seen in request.observations]
            where = mount(parent, [seen[camera.name].stamp_ns for seen in found if camera.name in seen])
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


def fixed_to(camera: CameraModel, rotation: Array, origin: Array) -> CameraModel:
    """Return a camera with the pose relative to a frame instead of the world.

    Args:
        camera: The camera, its pose in the world.
        rotation: Rotation frame -> world, shape (3, 3).
        origin: Origin of the frame in the world, shape (3,) [m].
    """
    translation = camera.R_cam_base @ origin + camera.t_cam_base
    return replace(camera, R_cam_base=camera.R_cam_base @ rotation, t_cam_base=translation)
