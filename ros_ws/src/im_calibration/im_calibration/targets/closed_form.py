"""Places of targets to start from: each view alone, then views, cameras and robot together, in closed form.

Sources: Zhang, "A flexible new technique for camera calibration" (2000), as in OpenCV's ``calibrateCamera``; Tsai and
Lenz (1989), Park and Martin (1994), Daniilidis (1999), Shah (2013) and Li et al. (2010) for robot and camera, as in
OpenCV. Of the solutions for robot and camera the one with the least median misfit is taken.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from im_calibration.errors import DegenerateDataError, InconsistentDataError
from im_calibration.targets.views import RobotPoses, TargetViews
from im_calibration.turn_slips import mirrored_axes, turn_slips, turned_axes
from im_cell.camera_model import CameraModel
from im_cell.lens import EQUIDISTANT, RATIONAL_POLYNOMIAL, lens_of
from im_core.errors import DataError

Array = NDArray[np.float64]

_FEWEST_POINTS, _FEWEST_VIEWS, _MOST_VIEWS = 6, 3, 30
_FEWEST_POSES = 3
_HAND_EYE = (cv2.CALIB_HAND_EYE_TSAI, cv2.CALIB_HAND_EYE_PARK, cv2.CALIB_HAND_EYE_DANIILIDIS)
_ROBOT_WORLD = (cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH, cv2.CALIB_ROBOT_WORLD_HAND_EYE_LI)
_BETTER, _RIVAL, _WRONG_SHARE = 5.0, 1.5, 0.02
_FEWEST_SCALED, _SCALED = 8, 0.01
_SCALE_DEVIATION = 0.03
_UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}
_DIGITS = 5


@dataclass(frozen=True)
class PlacedTarget:
    """Places of the target to start from.

    Attributes:
        world: Frames of rest of the target in the world, one a view, shape (k, 4, 4); all the same without a robot.
        places: The target in these frames: one that holds for all views, shape (1, 4, 4), or one a view, (k, 4, 4).
    """

    world: Array
    places: Array


def place_target(views: TargetViews) -> PlacedTarget:
    """Return places of the target, from nothing but the views.

    Raises:
        DegenerateDataError: There are too few views, cameras have no view in common, or the robot does not turn.
        InconsistentDataError: No camera explains a camera's views; or the robot's poses do not belong to them as they
            are; what they would do with is named.
    """
    seen, faults = [], list[DegenerateDataError | InconsistentDataError]()
    for c in range(len(views.camera_names)):
        try:
            seen.append(_targets_in_camera(views, c))
        except (DegenerateDataError, InconsistentDataError) as error:
            faults.append(error)
    # a robot says for every camera where the target is: one that says little itself is judged with the others
    if faults and (views.robot is None or not seen):
        raise faults[0]
    if views.robot is None:
        places = _together(views, seen)
        still = np.tile(np.eye(4), (len(views.names), 1, 1))
        return PlacedTarget(still, np.array([_rounded(place) for place in places]))
    world, place = _with_robot(views.robot, seen)
    return PlacedTarget(world, _rounded(place)[None])


def _rounded(place: Array) -> Array:
    """Round a place to start from: OpenCV's threads leave the last digits to chance."""
    turn = np.round(np.ravel(cv2.Rodrigues(place[:3, :3])[0]), _DIGITS)
    return _transform(np.asarray(cv2.Rodrigues(turn)[0]), np.round(place[:3, 3], _DIGITS))


def _targets_in_camera(views: TargetViews, c: int) -> dict[int, Array]:
    """Return the target in the camera's frame by view, from the views of one camera alone."""
    name, usable = views.camera_names[c], np.flatnonzero(views.seen[c].sum(axis=1) >= _FEWEST_POINTS)
    given = views.given.get(name)
    fewest = 1 if given else _FEWEST_VIEWS
    if len(usable) < fewest:
        raise DegenerateDataError(
            f"Camera {name} saw the target in {len(usable)} images, at least {fewest} are needed.",
            "Take 20 or more, the target turned by 30 degrees about two axes and in all parts of the image.",
            parameters=(f"{name}.intrinsics",),
            camera=name,
        )
    lens = lens_of(views.lens_models[c])
    if given:
        values = given[0]
        K, D = _matrix(values), lens.all_of(values[4 : 4 + lens.estimated])
    else:
        K, D = _intrinsics(views, c, usable)
    width, height = views.image_sizes[c]
    camera = CameraModel(width, height, K, D, distortion_model=lens.name)
    found = {}
    for k in usable:
        here = views.seen[c, k]
        try:
            ideal = camera.undistort(views.spots[c, k, here])
        except DataError:  # a lens to start from need not hold in each view
            continue
        solved, turn, shift = cv2.solvePnP(views.points[here], ideal, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
        if solved:
            found[int(k)] = _transform(np.asarray(cv2.Rodrigues(turn)[0]), np.ravel(shift))
    return found


def _intrinsics(views: TargetViews, c: int, usable: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return camera matrix and lens of the camera by the usual program."""
    chosen = usable[np.unique(np.linspace(0, len(usable) - 1, _MOST_VIEWS).round().astype(int))]
    points = [views.points[views.seen[c, k]].astype(np.float32) for k in chosen]
    spots = [views.spots[c, k, views.seen[c, k]].astype(np.float32) for k in chosen]
    lens, size = lens_of(views.lens_models[c]), views.image_sizes[c]
    try:
        if lens is EQUIDISTANT:
            flags = cv2.fisheye.CALIB_RECOMPUTE_EXTRINSIC | cv2.fisheye.CALIB_FIX_SKEW
            inside = [each[None] for each in points], [each[None] for each in spots]
            error, K, D, _, _ = cv2.fisheye.calibrate(inside[0], inside[1], size, np.eye(3), np.zeros(4), flags=flags)
        else:
            flags = cv2.CALIB_RATIONAL_MODEL if lens is RATIONAL_POLYNOMIAL else cv2.CALIB_FIX_K3
            error, K, D, _, _ = cv2.calibrateCamera(points, spots, size, np.eye(3), np.zeros(5), flags=flags)
    except cv2.error:
        error = np.inf
    if not np.isfinite(error) or error > _WRONG_SHARE * size[0]:
        raise InconsistentDataError(
            f"No camera explains where {views.camera_names[c]} saw the points of the target.",
            "Check the target's rows, columns and lengths.",
            camera=views.camera_names[c],
        )
    return np.asarray(K), lens.all_of(np.ravel(D)[: len(lens.coefficients)])


def _together(views: TargetViews, seen: list[dict[int, Array]]) -> Array:
    """Return the target in the first camera's frame, by view; from the other cameras where the first saw none."""
    in_first = [np.eye(4)] + [np.full((4, 4), np.nan)] * (len(seen) - 1)  # of each camera
    known = {0}
    while len(known) < len(seen):
        pairs = [(len(seen[a].keys() & seen[b].keys()), a, b) for a in known for b in set(range(len(seen))) - known]
        count, a, b = max(pairs)
        if not count:
            others = ", ".join(views.camera_names[c] for c in sorted(set(range(len(seen))) - known))
            raise DegenerateDataError(
                f"No image of {others} has the target where another camera has it at the same time.",
                "Show the target to the cameras together, and give images of one moment the same name.",
                parameters=(f"{views.camera_names[b]}.pose",),
                camera=views.camera_names[b],
            )
        steps = [seen[a][k] @ _inverse(seen[b][k]) for k in sorted(seen[a].keys() & seen[b].keys())]
        in_first[b] = in_first[a] @ _typical(np.array(steps))
        known.add(b)
    places = np.tile(np.eye(4), (len(views.names), 1, 1))
    for c in reversed(range(len(seen))):
        for k, pose in seen[c].items():
            places[k] = in_first[c] @ pose
    return places


def _with_robot(robot: RobotPoses, seen: list[dict[int, Array]]) -> tuple[Array, Array]:
    """Return the frames of rest in the world, and the target's place in a frame of rest."""
    c = max(range(len(seen)), key=lambda camera: len(seen[camera]))
    views = np.array(sorted(seen[c]))
    targets = np.array([seen[c][k] for k in views])
    if len(views) < _FEWEST_POSES:
        raise DegenerateDataError(
            f"The target was seen at {len(views)} poses of the robot, at least {_FEWEST_POSES} are needed.",
            "Take 20 or more, the wrist turned by 30 degrees about two axes between them.",
            parameters=("target.place",),
        )
    turns = robot.poses[views, :3, :3]
    if _one_axis(turns):
        raise DegenerateDataError(
            "The robot turns about one axis only, so that the places of camera and target cannot be told.",
            "Turn the wrist by 30 degrees or more about two axes.",
            parameters=("target.place",),
        )
    found = _least(frames_of(robot), targets, views)
    limit = _WRONG_SHARE * float(np.linalg.norm(np.ptp(targets[:, :3, 3], axis=0)))
    slips = list(_slip_of_lengths(robot, targets, views))
    if found[0] > limit:
        slips += _slips(robot)
    undone = sorted((_least(frames_of(other), targets, views)[0], sentence) for sentence, other in slips)
    if undone and undone[0][0] < min(found[0] / _BETTER, limit):
        least = undone[0][0]
        sentences = ", or ".join(sentence for misfit, sentence in undone if misfit <= _RIVAL * least)
        raise InconsistentDataError(
            f"The robot's poses and the target's do not belong together: they are off by {1e3 * found[0]:.2g} mm. "
            f"With {sentences}, they are off by {1e3 * least:.2g} mm.",
            "Correct what is named.",
        )
    return frames_of(robot), found[1]


def frames_of(robot: RobotPoses) -> Array:
    """Return the frames in which the target is at rest, in the world of the cameras, shape (k, 4, 4).

    The world is the base of the robot, or the wrist if the cameras are on it.
    """
    return np.asarray(_inverse(robot.poses) if robot.camera_moves else robot.poses)


def _one_axis(turns: Array) -> bool:
    """Check whether all turns are about one axis, or there are none."""
    relative = np.swapaxes(turns[:1], 1, 2) @ turns
    vectors = np.array([cv2.Rodrigues(turn)[0].ravel() for turn in relative])
    extent = np.linalg.svd(vectors, compute_uv=False)
    return bool(extent[1] < 0.02 * np.sqrt(len(turns)))


def _least(frames: Array, targets: Array, views: NDArray[np.intp]) -> tuple[float, Array]:
    """Return the median misfit [m] and the target's place of the best solution of ``targets = X frames Z``."""
    g = frames[views]
    best = (np.inf, np.eye(4))
    for x, z in _solutions(g, targets):
        if not (np.isfinite(x).all() and np.isfinite(z).all()):
            continue
        off = float(np.median(np.linalg.norm((x @ g @ z - targets)[:, :3, 3], axis=1)))
        if off < best[0]:
            best = off, z
    if not np.isfinite(best[0]):
        raise InconsistentDataError("No places of camera and target explain the views.", "Check the robot's poses.")
    return best


def _solutions(g: Array, targets: Array) -> Iterator[tuple[Array, Array]]:
    inverse = _inverse(g)
    for method in _HAND_EYE:
        try:
            turn, shift = cv2.calibrateHandEye(*_listed(inverse), *_listed(targets), method=method)
        except cv2.error:
            continue
        x = _inverse(_transform(turn, np.ravel(shift)))
        if np.isfinite(x).all():
            yield x, _typical(inverse @ _inverse(x) @ targets)
    for method in _ROBOT_WORLD:
        try:
            turn, shift, turn_x, shift_x = cv2.calibrateRobotWorldHandEye(*_listed(targets), *_listed(g), method=method)
        except cv2.error:
            continue
        z = _inverse(_transform(turn, np.ravel(shift)))
        yield _transform(turn_x, np.ravel(shift_x)), z


def _listed(transforms: Array) -> tuple[list[Array], list[Array]]:
    """Return rotations and translations in the form of OpenCV."""
    return list(transforms[:, :3, :3]), list(transforms[:, :3, 3])


def _slip_of_lengths(robot: RobotPoses, targets: Array, views: NDArray[np.intp]) -> Iterator[tuple[str, RobotPoses]]:
    """Yield the robot's poses with lengths of the best fit to the target, if these are others."""
    g = frames_of(robot)[views]
    try:
        turn, _ = cv2.calibrateHandEye(*_listed(_inverse(g)), *_listed(targets), method=cv2.CALIB_HAND_EYE_PARK)
    except cv2.error:
        return
    if not np.isfinite(turn).all():
        return
    # targets = X g Z: with the turn of X known, places are linear in those of X and Z and in the factor
    turned = turn.T @ g[:, :3, :3]
    moved = (turn.T @ g[:, :3, 3:])[..., 0]
    columns = np.concatenate((turned, moved[..., None], np.tile(np.eye(3), (len(g), 1, 1))), axis=2)
    solved, *_ = np.linalg.lstsq(columns.reshape(-1, 7), targets[:, :3, 3].ravel())
    factor = float(solved[3])
    if not factor > 0.0 or abs(factor - 1.0) < _SCALED:
        return
    poses = robot.poses.copy()
    poses[:, :3, 3] *= factor
    for unit, size in _UNITS.items():
        if abs(factor / size - 1.0) < _SCALE_DEVIATION:
            yield f"places in {unit}", replace(robot, poses=poses)
            return
    if len(views) >= _FEWEST_SCALED:  # a factor makes a few views fit, whatever is wrong
        sentence = f"the target {1.0 / factor:.3g} times as large, or places {factor:.3g} times as far apart"
        yield sentence, replace(robot, poses=poses)


def _slips(robot: RobotPoses) -> Iterator[tuple[str, RobotPoses]]:
    """Yield common slips in turns, axes and pairing, each with the corrected poses."""

    def other(turns: Array, shifts: Array) -> RobotPoses:
        poses = robot.poses.copy()
        poses[:, :3, :3], poses[:, :3, 3] = turns, shifts
        return replace(robot, poses=poses)

    turns, shifts = robot.poses[:, :3, :3], robot.poses[:, :3, 3]
    for slip in turn_slips(turns):
        yield f"{slip.numbers} read as {slip.own}", other(slip.turns, shifts)
    yield "the rotations transposed", other(np.swapaxes(turns, 1, 2), shifts)
    moved = "--eye-to-hand" if robot.camera_moves else "--eye-in-hand"  # which is the same as the other way round
    yield f"their inverses (base in the link), or {moved}", replace(robot, camera_moves=not robot.camera_moves)
    for shift, where in ((1, "later"), (-1, "earlier")):
        yield f"the poses taken one image {where}", replace(robot, poses=np.roll(robot.poses, shift, axis=0))
    for phrase, axes in (*mirrored_axes(), *turned_axes()):
        yield f"{phrase} in the places", other(turns, shifts @ axes.T)
    mirror = np.diag([1.0, -1.0, 1.0])
    yield "left-handed axes of the robot, or all images mirrored", other(mirror @ turns @ mirror, shifts @ mirror)


def _typical(transforms: Array) -> Array:
    """Return the transform nearest to all others."""
    turned = np.einsum("aij,bij->ab", transforms[:, :3, :3], transforms[:, :3, :3])
    angles = np.arccos(np.clip((turned - 1.0) / 2.0, -1.0, 1.0))
    apart = np.linalg.norm(transforms[:, None, :3, 3] - transforms[None, :, :3, 3], axis=2)
    scale = max(float(np.median(np.linalg.norm(transforms[:, :3, 3], axis=1))), 1e-9)
    return np.asarray(transforms[int(np.argmin((angles + apart / scale).sum(axis=1)))])


def _matrix(values: Array) -> Array:
    return np.array([[values[0], 0.0, values[2]], [0.0, values[1], values[3]], [0.0, 0.0, 1.0]])


def _inverse(transforms: Array) -> Array:
    return np.asarray(np.linalg.inv(transforms), dtype=np.float64)


def _transform(turn: NDArray[Any], shift: NDArray[Any]) -> Array:
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = turn, shift
    return whole
