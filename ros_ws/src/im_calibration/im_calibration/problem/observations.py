"""Observations of a light, or a target, on the wrist as they are made, and the calibration problem of them."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_calibration.problem.problem import CalibrationProblem, KnownLengths
from im_calibration.targets.target import CalibrationTarget
from im_calibration.targets.views import RobotPoses, TargetViews
from im_cell.lens import PLUMB_BOB
from im_cell.rotations import matrix_of_quaternion
from im_cell.workspace import Workspace, box_around
from im_core.errors import DataError, NotFoundError

Array = NDArray[np.float64]

#: Successive observations are of an arm that has stayed, where it is no farther off [m], nor turned more [rad].
_STAYED_M, _STAYED_RAD = 1e-4, 2e-4


TARGET_NOISE = ("image",)
"""Noise that is estimated with a target on the wrist: edges that a lens bends move corners by more than pixels do."""


@dataclass(frozen=True)
class SeenSpot:
    """Light in a camera: centre, shape (2,) [px], the covariance, shape (2, 2) [px^2], and the time [ns]."""

    uv: Array
    covariance: Array
    stamp_ns: int


@dataclass(frozen=True)
class SeenPoints:
    """Points of a target in a camera.

    Attributes:
        uv: Places, NaN where not found, shape (p, 2) [px].
        standard_deviations: Of each coordinate, NaN where not known, shape (p,) [px].
        stamp_ns: When the image was exposed [ns].
    """

    uv: Array
    standard_deviations: Array
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
        arm_jacobian: Derivatives of the place of the light by errors of the arm's kinematics, each of its usual size,
            shape (3, m) [m]; with `views` of place and turn of the wrist, shape (6, m); none where they are not known.
        views: In place of spots, points of a target on the wrist, by camera.
        wrist_covariance: Covariance of place and turn of the wrist, for `views`, shape (6, 6) [m^2], [m rad], [rad^2].
    """

    pose: str
    position: Array
    rotation: Array
    position_covariance: Array
    spots: dict[str, SeenSpot]
    arm_jacobian: Array = field(default_factory=lambda: np.zeros((3, 0)))
    views: dict[str, SeenPoints] = field(default_factory=dict)
    wrist_covariance: Array = field(default_factory=lambda: np.zeros((6, 6)))


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


def problem_of(
    cameras: tuple[str, ...],
    observations: Sequence[Observation],
    lengths: Sequence[SeenLength],
    image_sizes: Mapping[str, tuple[int, int]],
    led_offset: tuple[tuple[float, float, float], float],
    known: Collection[str],
    workspace: Workspace | None,
) -> CalibrationProblem:
    """Return observations in the solver's terms.

    Args:
        cameras: Names of the cameras to calibrate.
        observations: What they saw.
        lengths: Known lengths; may be empty.
        image_sizes: Width and height of the images of each camera [px].
        led_offset: Nominal place of the light in the wrist frame, and how well each axis of it is known [m].
        known: Cameras that there are; others than `cameras` may have spots.
        workspace: Where errors are predicted; None: around the places of the light.

    Raises:
        ImError: There is no observation, one is malformed, or of a camera that is not known, or they are of arms with
            different numbers of errors.
    """
    if not observations:
        raise DataError("there is no observation to calibrate from")
    nominal, prior_sd = led_offset
    offset, errors = np.array(nominal), {o.arm_jacobian.shape[1] for o in observations}
    if len(errors) > 1:
        raise DataError(f"the observations have arm_jacobian of {sorted(errors)} columns, one number is needed")
    spots, covariances = _spots(cameras, [observation.spots for observation in observations], known)
    positions = np.array([o.position + o.rotation @ offset for o in observations])
    return CalibrationProblem(
        camera_names=cameras,
        image_sizes=tuple(image_sizes[camera] for camera in cameras),
        positions=positions,
        position_covariances=np.array([o.position_covariance for o in observations]),
        wrist_rotations=np.array([o.rotation for o in observations]),
        spots=spots,
        spot_covariances=covariances,
        workspace=workspace or box_around(positions),
        led_offset_prior_sd=prior_sd,
        arm_jacobians=np.array([o.arm_jacobian for o in observations]) if errors != {0} else None,
        led_offset_nominal=nominal,
        pose_names=tuple(o.pose for o in observations),
        readings=_readings(observations),
        lengths=_lengths(cameras, lengths, known) if lengths else None,
    )


def views_of(
    cameras: tuple[str, ...],
    observations: Sequence[Observation],
    target: CalibrationTarget,
    image_sizes: Mapping[str, tuple[int, int]],
    known: Collection[str],
) -> TargetViews:
    """Return observations of a target on the wrist as views, for :func:`problem_of_views`.

    Args:
        cameras: Names of the cameras to calibrate.
        observations: What they saw.
        target: The target.
        image_sizes: Width and height of the images of each camera [px].
        known: Cameras that there are; others than `cameras` may have views.

    Raises:
        ImError: There is no observation, or one is of a camera that is not known, of another number of points or of
            another arm than the others.
    """
    if not observations:
        raise DataError("there is no observation to calibrate from")
    count = len(cameras), len(observations), len(target.points)
    spots, deviations = np.full((*count, 2), np.nan), np.full(count, np.nan)
    poses = np.tile(np.eye(4), (len(observations), 1, 1))
    for k, observation in enumerate(observations):
        numbers = observation.position, observation.wrist_covariance, observation.arm_jacobian
        if not all(np.isfinite(each).all() for each in numbers):
            raise DataError(f"pose '{observation.pose}' holds a value that is not finite", pose=observation.pose)
        poses[k, :3, :3], poses[k, :3, 3] = observation.rotation, observation.position
        for camera, seen in observation.views.items():
            if camera not in known:
                raise NotFoundError(kind="camera", name=camera, known=known)
            if len(seen.uv) != count[2]:
                told = f"pose '{observation.pose}': {camera} has {len(seen.uv)} points"
                raise DataError(f"{told}, the target {target} has {count[2]}", camera=camera)
            if camera in cameras:
                c = cameras.index(camera)
                spots[c, k], deviations[c, k] = seen.uv, seen.standard_deviations
    shapes = {o.arm_jacobian.shape for o in observations}
    if len(shapes) > 1:
        raise DataError(f"the observations have arm_jacobian of shapes {sorted(shapes)}, one is needed")
    arm = np.array([o.arm_jacobian for o in observations])
    covariances = np.array([o.wrist_covariance for o in observations])
    robot = RobotPoses(poses, False, 0.0, 0.0, covariances, arm if arm.shape[1:] > (6, 0) else None)
    names = tuple(o.pose for o in observations)
    lenses, sizes = (PLUMB_BOB.name,) * len(cameras), tuple(image_sizes[camera] for camera in cameras)
    return TargetViews(str(target), target.points, cameras, sizes, lenses, names, spots, deviations, robot, {})


def _readings(observations: Sequence[Observation]) -> tuple[str, ...]:
    """Label successive observations of an arm that stayed as one reading of the robot; empty without such ones.

    The error of the arm is the same in all of them, and only the noise of their spots is averaged.
    """
    labels = [observations[0].pose]
    for before, now in pairwise(observations):
        way = np.linalg.norm(now.position - before.position)
        turn = np.linalg.norm(now.rotation - before.rotation)
        labels.append(labels[-1] if way < _STAYED_M and turn < _STAYED_RAD else now.pose)
    return tuple(labels) if len(set(labels)) < len(labels) else ()


def observation_of(message: Any) -> Observation:
    """Return an observation.

    Args:
        message: An ``im_msgs/msg/Observation``, from a client, out of a bag, or any object with the fields of it.

    Raises:
        DataError: It holds numbers that are not finite, or no rotation, or two spots of a camera, or an arm_jacobian
            without three rows, with views six.
    """
    views = _views_seen(getattr(message, "views", ()), f"pose '{message.pose}'")  # bags of former versions have none
    rows, count = (6, "six") if views else (3, "three")
    if len(message.arm_jacobian) % rows:
        told = f"arm_jacobian of pose '{message.pose}' has {len(message.arm_jacobian)} numbers, {count} rows are needed"
        raise DataError(told)
    position, q = message.wrist.position, message.wrist.orientation
    return Observation(
        pose=message.pose,
        position=np.array([position.x, position.y, position.z]),
        rotation=matrix_of_quaternion([q.x, q.y, q.z, q.w], f"the orientation of pose '{message.pose}'"),
        position_covariance=np.array(message.position_covariance).reshape(3, 3),
        spots=spots_of(message.spots, f"pose '{message.pose}'"),
        arm_jacobian=np.array(message.arm_jacobian).reshape(rows, -1),
        views=views,
        wrist_covariance=np.array(message.wrist_covariance).reshape(6, 6) if views else np.zeros((6, 6)),
    )


def _views_seen(messages: Sequence[Any], place: str) -> dict[str, SeenPoints]:
    """Return points of a target by camera, without cameras that did not find it.

    Raises:
        DataError: Two views are of one camera, or the lists of one differ in length, or hold what cannot be.
    """
    views: dict[str, SeenPoints] = {}
    for view, stamp_ns in _found(messages, place, "views"):
        lists = [np.array(each, dtype=float) for each in (view.u, view.v, view.sd)]
        if len({len(each) for each in lists}) != 1:
            raise DataError(f"{place}: u, v and sd of {view.camera} have {[len(each) for each in lists]} numbers")
        u, v, deviations = lists
        if np.isinf(lists).any() or (np.isnan(u) != np.isnan(v)).any() or (deviations <= 0.0).any():
            raise DataError(f"{place}: the view of {view.camera} has a point that cannot be", camera=view.camera)
        views[view.camera] = SeenPoints(np.column_stack((u, v)), deviations, stamp_ns)
    return views


def spots_of(messages: Sequence[Any], place: str) -> dict[str, SeenSpot]:
    """Return spots of one light by camera, without spots not found.

    Args:
        messages: Each an ``im_msgs/msg/Spot``, or like it.
        place: Of what they are, for errors.

    Raises:
        DataError: Two are of one camera, or a number is not finite, or a covariance is none.
    """
    spots: dict[str, SeenSpot] = {}
    for spot, stamp_ns in _found(messages, place, "spots"):
        uv, covariance = np.array([spot.u, spot.v]), np.array(spot.covariance).reshape(2, 2)
        if not np.all(np.isfinite(uv)):
            raise DataError(f"{place}: the spot of {spot.camera} at {uv.tolist()} px is not finite", camera=spot.camera)
        if not _is_covariance(covariance):
            raise DataError(f"{place}: {covariance.tolist()} is no covariance of a spot of {spot.camera} [px^2]")
        spots[spot.camera] = SeenSpot(uv, covariance, stamp_ns)
    return spots


def _found(messages: Sequence[Any], place: str, what: str) -> Iterator[tuple[Any, int]]:
    """Yield the messages of found spots or views, each with the stamp [ns].

    Raises:
        DataError: Two are of one camera.
    """
    cameras = set[str]()
    for each in messages:
        if each.found:
            if each.camera in cameras:
                raise DataError(f"{place} has two {what} of {each.camera}", camera=each.camera)
            cameras.add(each.camera)
            yield each, each.stamp.sec * 10**9 + each.stamp.nanosec


def _is_covariance(matrix: Array) -> bool:
    """Whether a matrix, shape (n, n), is finite, symmetric and positive definite."""
    if not np.all(np.isfinite(matrix)) or np.abs(matrix - matrix.T).max() > 1e-6 * np.abs(matrix).max():
        return False
    return bool(np.linalg.eigvalsh(matrix)[0] > 0.0)


def _lengths(cameras: tuple[str, ...], lengths: Sequence[SeenLength], known: Collection[str]) -> KnownLengths:
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
