"""The problem of views of a target, and the form of views in data sets: the block ``target`` of ``vislab-calib-1``."""

from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PlainValidator, StrictBool, model_validator

from im_calibration.problem.arm_error import ArmError
from im_calibration.problem.fields import Lists, Names, positive
from im_calibration.problem.placements import GivenIntrinsics, Placements
from im_calibration.problem.problem import CalibrationProblem
from im_calibration.targets.views import RobotPoses, TargetViews
from im_cell.lens import lens_of
from im_cell.rotations import cross_matrix
from im_cell.workspace import box_around
from im_core.config import FieldError, Model

Array = NDArray[np.float64]

_UNSTATED_PX, _UNSTATED_M, _UNSTATED_RAD = 0.1, 1e-3, 2e-3
_RIGID = 1e-4
_ROUNDING = 1e-9


class RobotTable(Model):
    """Poses of a link in the robot's base, rows of 4 x 4 matrices [-], [m]; noise null: not known."""

    poses: Annotated[Array, PlainValidator(Lists("k", 4, 4))]
    camera_moves: StrictBool
    sd_m: Annotated[float, Field(gt=0, lt=1)] | None = None
    sd_rad: Annotated[float, Field(gt=0, lt=1)] | None = None
    cov: Annotated[Array | None, PlainValidator(Lists("k", 6, 6, optional=True))] = None
    J_arm: Annotated[Array | None, PlainValidator(Lists("k", 6, "m", optional=True))] = None

    @model_validator(mode="after")
    def _rigid(self) -> Self:
        turns = self.poses[:, :3, :3]
        defect = np.abs(turns @ np.swapaxes(turns, 1, 2) - np.eye(3)).max(axis=(1, 2))
        wrong = (defect > _RIGID) | (np.linalg.det(turns) < 0.0) | np.any(self.poses[:, 3] != (0, 0, 0, 1), axis=1)
        for k in np.flatnonzero(wrong):
            raise FieldError(("poses", int(k)), "is no pose: a rotation, a place, and the row 0 0 0 1 are needed")
        for name in ("cov", "J_arm"):
            if getattr(self, name) is not None and self.camera_moves:
                raise FieldError((name,), "is for a target on the robot; here the cameras are on it")
        if self.cov is not None and (np.linalg.eigvalsh(self.cov)[:, 0] < -_ROUNDING * np.abs(self.cov).max()).any():
            raise FieldError(("cov",), "has a matrix that is no covariance")
        return self


class GivenTable(Model):
    """Intrinsics of a camera from elsewhere; held if the covariance is null."""

    values: list[float]
    covariance: list[list[float]] | None = None


class TargetTable(Model):
    """Views of a target: points [m], places of the points in images [px], and the robot's poses."""

    name: str = ""
    points_m: Annotated[Array, PlainValidator(Lists("p", 3))]
    u_px: Annotated[Array, PlainValidator(Lists("c", "k", "p", 2, holes=True))]
    sigma_u_px: Annotated[Array | None, PlainValidator(Lists("c", "k", "p", optional=True))] = None
    views: Annotated[tuple[str, ...] | None, PlainValidator(Names("k"))] = None
    robot: RobotTable | None = None
    intrinsics: dict[str, GivenTable] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _positive(self) -> Self:
        if self.sigma_u_px is not None:
            try:
                positive(self.sigma_u_px)
            except FieldError as error:
                raise FieldError(("sigma_u_px", *error.location), str(error)) from error
        return self

    def problem(
        self,
        camera_names: tuple[str, ...],
        image_sizes: tuple[tuple[int, int], ...],
        lens_models: tuple[str, ...],
        noise_to_estimate: tuple[str, ...],
    ) -> CalibrationProblem:
        """Return the problem of the views.

        Raises:
            DegenerateDataError: There are too few views, or they do not belong together.
            InconsistentDataError: No cameras explain the views.
            DataError: A value cannot be.
        """
        robot = self.robot
        poses = None
        if robot is not None:
            noise = robot.sd_m or _UNSTATED_M, robot.sd_rad or _UNSTATED_RAD
            poses = RobotPoses(robot.poses, robot.camera_moves, *noise, robot.cov, robot.J_arm)
        unknown = set(noise_to_estimate)
        unknown |= {"image"} if self.sigma_u_px is None else set()
        unknown |= {"robot"} if robot and robot.cov is None and None in (robot.sd_m, robot.sd_rad) else set()
        count = self.u_px.shape[:3]
        views = TargetViews(
            self.name,
            self.points_m,
            camera_names,
            image_sizes,
            lens_models,
            self.views or tuple(str(k) for k in range(count[1])),
            self.u_px,
            np.full(count, _UNSTATED_PX) if self.sigma_u_px is None else self.sigma_u_px,
            poses,
            {name: _given(given) for name, given in self.intrinsics.items()},
        )
        return problem_of_views(views, tuple(source for source in ("image", "robot") if source in unknown))


def problem_of_views(views: TargetViews, noise_to_estimate: tuple[str, ...]) -> CalibrationProblem:
    """Return the problem of some views: the position of each point in each view is one of the problem's poses.

    Args:
        views: The views.
        noise_to_estimate: Whose noise is known up to a factor only.

    Raises:
        DegenerateDataError: There are too few views, or they do not belong together.
        InconsistentDataError: No cameras explain the views.
    """
    from im_calibration.targets.closed_form import place_target  # loads OpenCV, which lights do not need

    placed, robot = place_target(views), views.robot
    k, p = np.nonzero(views.seen.any(axis=0))
    of = k if robot is None else np.zeros_like(k)
    if robot is None:  # only views that a camera saw have a place
        of = np.unique(k, return_inverse=True)[1]
    places, frames = placed.places[k if robot is None else of], placed.world[k]
    points = (places[:, :3, :3] @ views.points[p][..., None])[..., 0] + places[:, :3, 3]
    positions = (frames[:, :3, :3] @ points[..., None])[..., 0] + frames[:, :3, 3]
    roots = arm_jacobians = arm = None
    if robot is not None:
        levers = _levers(robot, frames, points)
        roots = _roots(robot, k, levers)
        arm_jacobians = None if robot.arm is None else levers @ robot.arm[k]
        arm = ArmError.of_readings(robot.poses, k, levers) if robot.arm is None else None
    deviations = np.where(np.isfinite(views.deviations), views.deviations, np.nanmedian(views.deviations))
    n = len(k)
    given = tuple(_precision(views, c) for c in range(len(views.camera_names)))
    return CalibrationProblem(
        camera_names=views.camera_names,
        image_sizes=views.image_sizes,
        positions=positions,
        position_covariances=np.zeros((n, 3, 3)) if roots is None else roots @ np.swapaxes(roots, 1, 2),
        wrist_rotations=np.tile(np.eye(3), (n, 1, 1)),
        arm_jacobians=arm_jacobians,
        spots=views.spots[:, k, p],
        spot_covariances=deviations[:, k, p][..., None, None] ** 2 * np.eye(2),
        pose_names=tuple(f"{views.names[view]} point {point}" for view, point in zip(k, p, strict=True)),
        workspace=box_around(positions),
        lens_models=views.lens_models,
        noise_to_estimate=noise_to_estimate,
        readings=() if robot is None else tuple(views.names[view] for view in k),
        placements=Placements(
            of,
            frames[:, :3, :3],
            points,
            placed.places[np.unique(k)] if robot is None else placed.places,
            arm,
            roots,
            np.zeros(3) if robot is None else None,
            robot is not None and robot.camera_moves,
        ),
        given_intrinsics=given if any(given) else (),
    )


def _roots(robot: RobotPoses, of: NDArray[np.intp], levers: Array) -> Array:
    """Return derivatives of points by six errors of unit variance of a reading, shape (n, 3, 6) [m].

    Args:
        robot: The readings.
        of: Which reading each point is of, shape (n,).
        levers: Derivatives of the points by a shift and a turn of the link, shape (n, 3, 6) [-], [m].
    """
    if robot.covariances is None:
        return np.asarray(levers * np.repeat([robot.sd_m, robot.sd_rad], 3))
    values, axes = np.linalg.eigh(robot.covariances)
    return np.asarray(levers @ (axes * np.sqrt(np.maximum(values, 0.0))[:, None, :])[of, :, ::-1])


def _levers(robot: RobotPoses, frames: Array, points: Array) -> Array:
    """Return derivatives of points in the world by a shift and a turn of the link in the base, shape (n, 3, 6).

    Args:
        robot: Whether the target or the cameras are on the link.
        frames: Poses in which the target rests, shape (n, 4, 4).
        points: Points there, shape (n, 3) [m].
    """
    turns = frames[:, :3, :3]
    if robot.camera_moves:  # the world is the link, which leaves points at rest in the base
        link = -(np.swapaxes(turns, 1, 2) @ frames[:, :3, 3:])[..., 0]
        return np.concatenate((-turns, turns @ cross_matrix(points - link)), axis=2)
    arms = (turns @ points[..., None])[..., 0]
    return np.concatenate((np.tile(np.eye(3), (len(points), 1, 1)), -cross_matrix(arms)), axis=2)


def _given(given: GivenTable) -> tuple[Array, Array]:
    values = np.array(given.values)
    if given.covariance is None:
        return values, np.diag(_HELD * np.maximum(np.abs(values), 1e-3)) ** 2
    return values, np.array(given.covariance)


_HELD = 1e-7


def _precision(views: TargetViews, c: int) -> GivenIntrinsics | None:
    given, lens = views.given.get(views.camera_names[c]), lens_of(views.lens_models[c])
    if given is None:
        return None
    values, covariance = given
    size = 4 + lens.estimated
    if len(values) != size or covariance.shape != (size, size):
        raise FieldError(
            ("intrinsics", views.camera_names[c]),
            f"has {len(values)} values and a covariance of shape {covariance.shape}; {size} are needed for {lens.name}",
        )
    scale = 1.0 / np.sqrt(np.diag(covariance))
    scaled = np.linalg.inv(covariance * scale[:, None] * scale)
    return GivenIntrinsics(values, scaled * scale[:, None] * scale)


def table_of(views: TargetViews) -> dict[str, Any]:
    """Return the block ``target`` of a data set of some views."""
    spots = [[[None if np.isnan(u[0]) else u.tolist() for u in view] for view in camera] for camera in views.spots]
    filled = np.where(np.isfinite(views.deviations), views.deviations, _median(views.deviations))
    robot = views.robot
    return {
        "name": views.target,
        "points_m": views.points.tolist(),
        "views": list(views.names),
        "u_px": spots,
        "sigma_u_px": filled.tolist(),
        "robot": robot
        and {
            "poses": robot.poses.tolist(),
            "camera_moves": robot.camera_moves,
            "sd_m": robot.sd_m if robot.covariances is None else None,
            "sd_rad": robot.sd_rad if robot.covariances is None else None,
            "cov": None if robot.covariances is None else robot.covariances.tolist(),
            "J_arm": None if robot.arm is None else robot.arm.tolist(),
        },
        "intrinsics": {
            name: {"values": values.tolist(), "covariance": covariance.tolist()}
            for name, (values, covariance) in views.given.items()
        },
    }


def _median(deviations: Array) -> float:
    known = deviations[np.isfinite(deviations)]
    return float(np.median(known)) if len(known) else _UNSTATED_PX
