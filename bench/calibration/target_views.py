"""Synthetic views of a target with known truth: places of points in images, and poses of a robot, with noise."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from im_calibration.judgement.calibration import Calibration
from im_calibration.targets.target import CalibrationTarget, target_of
from im_calibration.targets.views import RobotPoses, TargetViews
from im_cell.camera_model import CameraModel
from im_cell.rotations import matrix_of_vector

Array = NDArray[np.float64]

_SIZE = (640, 480)
JOBS = ("one camera", "two cameras", "eye-to-hand", "eye-in-hand")
"""What there is to calibrate."""


@dataclass(frozen=True)
class TrueViews:
    """Views with the truth of them.

    Attributes:
        views: What a calibration may see.
        cameras: The cameras, in the frame of the first or of the robot.
        place: Target in the frame of the robot's link or base, shape (4, 4).
    """

    views: TargetViews
    cameras: tuple[CameraModel, ...]
    place: Array


def make_views(
    job: str,
    seed: int,
    *,
    target: CalibrationTarget | None = None,
    count: int = 15,
    sigma_px: float = 0.1,
    sd_m: float = 5e-4,
    sd_rad: float = 1e-3,
) -> TrueViews:
    """Return views of a target.

    Args:
        job: One of :data:`JOBS`.
        seed: Of everything.
        target: The target; None: a chessboard of 7 x 6 corners and 30 mm.
        count: Number of views.
        sigma_px: Noise of each image coordinate [px].
        sd_m: Noise of the robot's place, each coordinate [m].
        sd_rad: Noise of its turn, about each axis [rad].
    """
    rng = np.random.default_rng((1989, seed))
    target = target or target_of("chessboard:7x6:30mm")
    middle = target.points.mean(axis=0)
    robot = job.startswith("eye")
    camera_world = transform(rng.normal(0.0, 0.5, 3), rng.normal(0.0, 0.3, 3) + np.array([0.0, 0.0, 1.0]))
    place = transform(rng.normal(0.0, 0.5, 3), rng.normal(0.0, 0.1, 3))
    seen = []
    for _ in range(count):
        pose = transform(rng.normal(0.0, 0.35, 3), np.zeros(3))
        depth = rng.uniform(0.35, 0.6)
        pose[:3, 3] = [*(rng.uniform(-1.0, 1.0, 2) * (0.25, 0.18) * depth), depth] - pose[:3, :3] @ middle
        seen.append(pose)
    targets = np.array(seen)
    step = transform(np.array([0.02, 0.1, 0.01]), np.array([-0.12, 0.01, 0.02]))
    relative = [np.eye(4), step][: 2 if job == "two cameras" else 1]
    cameras, spots = [], []
    for each in relative:
        K = np.array(
            [[600.0 + rng.normal(0.0, 10.0), 0.0, 322.0], [0.0, 602.0, 236.0 + rng.normal(0.0, 5.0)], [0, 0, 1]]
        )
        D = np.array([-0.25, 0.08, 0.001, -0.0005, 0.0])
        camera = CameraModel(*_SIZE, K, D, each[:3, :3], each[:3, 3])
        points = np.array([camera.project(target.points @ pose[:3, :3].T + pose[:3, 3]) for pose in targets])
        points += rng.normal(0.0, sigma_px, points.shape)
        points[~np.all((points > 0.0) & (points < np.array(_SIZE) - 1.0), axis=-1)] = np.nan
        whole = each @ camera_world if robot else each
        cameras.append(CameraModel(*_SIZE, K, D, whole[:3, :3], whole[:3, 3]))
        spots.append(points)
    poses = None
    if robot:
        frames = np.linalg.inv(camera_world) @ targets @ np.linalg.inv(place)
        links = np.linalg.inv(frames) if job == "eye-in-hand" else frames
        read = np.array([
            transform(rng.normal(0.0, sd_rad, 3), np.zeros(3))[:3, :3] @ link[:3, :3] for link in links
        ])  # fmt: skip
        links = links.copy()
        links[:, :3, :3], links[:, :3, 3] = read, links[:, :3, 3] + rng.normal(0.0, sd_m, (count, 3))
        poses = RobotPoses(links, job == "eye-in-hand", sd_m, sd_rad)
    c = len(cameras)
    views = TargetViews(
        str(target), target.points, tuple(f"camera_{k}" for k in range(c)), (_SIZE,) * c, ("plumb_bob",) * c,
        tuple(f"view_{k}" for k in range(count)), np.array(spots), np.full((c, count, len(target.points)), sigma_px),
        poses, {},
    )  # fmt: skip
    return TrueViews(views, tuple(cameras), place)


def bent(true: TrueViews, size_m: float, seed: int) -> TrueViews:
    """Return the views of a robot that is off by a smooth error, a quadratic polynomial of the place.

    Args:
        true: The views of a robot that is not.
        size_m: RMS of each coordinate of the place [m]; the turns are off by 1 mrad for 1 mm.
        seed: Of the error.
    """
    robot = true.views.robot
    assert robot is not None
    away, poses = robot.poses[:, :3, 3] - robot.poses[:, :3, 3].mean(axis=0), robot.poses.copy()
    fields = np.random.default_rng((seed, 3)).normal(size=(2, 3, 3, 3))
    shifts, turns = (np.einsum("ni,nj,ijk->nk", away, away, field) for field in fields)
    poses[:, :3, 3] += size_m / np.sqrt((shifts**2).mean()) * shifts
    for pose, turn in zip(poses, size_m / np.sqrt((turns**2).mean()) * turns, strict=True):
        pose[:3, :3] = matrix_of_vector(turn) @ pose[:3, :3]
    return replace(true, views=replace(true.views, robot=replace(robot, poses=poses)))


def transform(vector: Array, shift: Array) -> Array:
    """Return the transform of a rotation vector [rad] and a shift [m], shape (4, 4)."""
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = matrix_of_vector(vector), shift
    return whole


def errors_over_expected(found: Calibration, true: TrueViews) -> Array:
    """Return the errors of all parameters that are not held, each over its standard deviation."""
    ratios = []
    for c, (camera, truth) in enumerate(zip(found.cameras, true.cameras, strict=True)):
        model, deviations = camera.model, camera.standard_deviations
        values = [np.concatenate((m.K[[0, 1, 0, 1], [0, 1, 2, 2]], m.D[:4])) for m in (model, truth)]
        ratios.append((values[0] - values[1]) / deviations[:8])
        if true.views.robot is not None or c > 0:
            turn = vector_of(model.R_cam_base @ truth.R_cam_base.T)
            ratios += [turn / deviations[8:11], (model.t_cam_base - truth.t_cam_base) / deviations[11:]]
    if found.target is not None:
        off = found.target.transform @ np.linalg.inv(true.place)
        deviations = np.sqrt(np.diag(found.target.covariance))
        ratios += [vector_of(off[:3, :3]) / deviations[:3], off[:3, 3] / deviations[3:]]
    return np.concatenate(ratios)


def vector_of(rotation: Array) -> Array:
    """Return the rotation vector of a small rotation [rad]."""
    return (
        np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
        / 2
    )
