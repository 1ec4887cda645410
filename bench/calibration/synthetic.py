"""Seeded synthetic calibration problems with their truth: for tests, and to see what a design of poses would give."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.unknowns import rotation_exp
from im_calibration.problem.problem import CalibrationProblem, KnownLengths
from im_cell.camera_model import CameraModel
from im_cell.workspace import Workspace

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_TURNS_RAD, _SHIFT_M, _GEAR_RAD = (3e-4, 3e-4, 1e-3), 2e-4, 3e-4
"""Usual errors of a joint: about the axes of its frame, the last its own, along them, and of its gear [rad, m, rad]."""

OUTLIER_KINDS = ("blob", "bias", "stale")
"""A blob anywhere in the image; a spot displaced by 2 to 10 px; a joint reading of another moment, 3 to 10 cm off."""

#: Where the light of a scene is, if its design says nothing else.
BOX = Workspace((-1.0, -0.5, 0.6), (1.0, 0.5, 1.6))


@dataclass(frozen=True)
class Design:
    """What to simulate.

    Attributes:
        poses: Number of poses.
        cameras: Number of cameras, in a row above the workspace.
        sigma_px: Standard deviation of each spot coordinate [px].
        sigma_m: Standard deviation of each coordinate of the LED position by the robot [m].
        anisotropy: Ratio of the largest to the smallest standard deviation of position and spot noise, axes random.
        heteroscedasticity: Ratio of the largest to the smallest standard deviation between poses, for both noises.
        outlier_share: Share of the poses that are gross outliers.
        missing_share: Share of the spots that were not detected.
        led_offset_prior_sd: Standard deviation of the LED offset error, drawn from it and told to the solver [m].
        joint_offset_prior_sd: Standard deviation of constant joint offsets, drawn and told likewise [rad].
        workspace: Box of the LED positions and of the predicted errors.
        scale_error: True lengths over those in the robot's metres, less 1.
        lengths: Number of placements of a bar with two LEDs, its length known to 0.1 mm.
    """

    poses: int = 40
    cameras: int = 2
    sigma_px: float = 0.1
    sigma_m: float = 4e-4
    anisotropy: float = 1.0
    heteroscedasticity: float = 1.0
    outlier_share: float = 0.0
    missing_share: float = 0.0
    led_offset_prior_sd: float = 5e-3
    joint_offset_prior_sd: float = 0.0
    workspace: Workspace = BOX
    scale_error: float = 0.0
    lengths: int = 0


@dataclass(frozen=True)
class SyntheticScene:
    """A problem and the truth behind it.

    Attributes:
        problem: What a solver may see.
        cameras: True cameras.
        led_offset_error: True error of the nominal LED offset [m], shape (3,).
        joint_offsets: True joint offsets [rad], shape (6,).
        outliers: Spots that are no honest observation, shape (c, n).
    """

    problem: CalibrationProblem
    cameras: tuple[CameraModel, ...]
    led_offset_error: Array
    joint_offsets: Array
    outliers: Mask


def make_scene(
    design: Design, seed: int, positions: Array | None = None, wrists: Array | None = None
) -> SyntheticScene:
    """Simulate the observations of a design.

    Args:
        design: What to simulate.
        seed: Seed of every draw.
        positions: True LED positions, shape (n, 3) [m]; None: drawn over the workspace.
        wrists: Wrist rotations, shape (n, 3, 3); None: drawn uniformly.
    """
    rng = np.random.default_rng(seed)
    low, high = np.array(design.workspace.low), np.array(design.workspace.high)
    n, c = design.poses, design.cameras
    truth = rng.uniform(low, high, (n, 3))
    truth = truth if positions is None else np.array(positions, dtype=float)
    drawn = random_rotations(rng, n)
    rotations = drawn if wrists is None else np.array(wrists, dtype=float)
    cameras = tuple(_draw_camera(rng, i, c, (low + high) / 2.0) for i in range(c))
    offset = rng.normal(0.0, 1.0, 3) * design.led_offset_prior_sd
    lever = truth[:, None, :] - np.linspace((0.0, 0.0, 0.7), (0.3, 0.2, 1.2), 6)
    jacobians = np.swapaxes(np.cross(random_rotations(rng, 2 * n).reshape(n, 6, 3), lever), 1, 2)
    joint_offsets = rng.normal(0.0, 1.0, 6) * design.joint_offset_prior_sd

    position_covariances = _covariances(rng, (n,), 3, design.sigma_m, design.anisotropy)
    spot_covariances = _covariances(rng, (c, n), 2, design.sigma_px, design.anisotropy)
    if design.heteroscedasticity > 1.0:
        spread = 2.0 * np.log(design.heteroscedasticity)
        position_covariances *= np.exp(rng.uniform(-0.5, 0.5, (n, 1, 1)) * spread)
        spot_covariances *= np.exp(rng.uniform(-0.5, 0.5, (c, n, 1, 1)) * spread)
    noise = np.linalg.cholesky(position_covariances) @ rng.normal(size=(n, 3, 1))
    measured = (truth - rotations @ offset - jacobians @ joint_offsets) / (1.0 + design.scale_error) + noise[..., 0]
    spots = np.stack([camera.project(truth) for camera in cameras])
    spots = spots + (np.linalg.cholesky(spot_covariances) @ rng.normal(size=(c, n, 2, 1)))[..., 0]
    outliers = np.zeros((c, n), dtype=bool)
    for i in np.flatnonzero(rng.random(n) < design.outlier_share):
        _spoil(rng, OUTLIER_KINDS[rng.integers(3)], int(i), spots, measured, outliers)
    inside = np.stack([camera.contains(spot) for camera, spot in zip(cameras, spots, strict=True)])
    spots[~inside | (rng.random((c, n)) < design.missing_share)] = np.nan
    problem = CalibrationProblem(
        camera_names=tuple(f"camera_{i}" for i in range(c)),
        image_sizes=((640, 480),) * c,
        positions=measured,
        position_covariances=position_covariances,
        wrist_rotations=rotations,
        spots=spots,
        spot_covariances=spot_covariances,
        led_offset_prior_sd=design.led_offset_prior_sd,
        joint_offset_prior_sd=design.joint_offset_prior_sd,
        joint_jacobians=jacobians if design.joint_offset_prior_sd > 0.0 else None,
        workspace=design.workspace,
        lengths=_place_lengths(np.random.default_rng((seed, 1)), design, cameras) if design.lengths else None,
    )
    return SyntheticScene(problem, cameras, offset, joint_offsets, outliers)


def with_stated_noise(problem: CalibrationProblem, factor: float) -> CalibrationProblem:
    """The same observations with all stated standard deviations multiplied by `factor`."""
    return replace(
        problem,
        position_covariances=problem.position_covariances * factor**2,
        spot_covariances=problem.spot_covariances * factor**2,
    )


def random_rotations(rng: np.random.Generator, count: int) -> Array:
    """Uniformly distributed rotations, shape (count, 3, 3)."""
    q, r = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    q = q * np.sign(np.einsum("nii->ni", r))[:, None, :]
    return np.asarray(q * np.linalg.det(q)[:, None, None])


def _draw_camera(rng: np.random.Generator, index: int, count: int, target: Array) -> CameraModel:
    """A camera about 3.2 m above the target that looks at it, off by 2 degrees, with a scattered lens."""
    x = 0.0 if count == 1 else -0.9 + 1.8 * index / (count - 1)
    centre = target + np.array([x, 0.35 * (-1.0) ** index, 3.2]) + rng.normal(0.0, 0.03, 3)
    z = (target - centre) / np.linalg.norm(target - centre)
    x_axis = np.cross(np.array([0.0, 1.0, 0.0]), z)
    x_axis /= np.linalg.norm(x_axis)
    rotation = rotation_exp(rng.normal(0.0, np.deg2rad(2.0), (1, 3)))[0] @ np.stack((x_axis, np.cross(z, x_axis), z))
    f = 600.0 * (1.0 + rng.normal(0.0, 0.01))
    cx, cy = rng.normal((319.5, 239.5), 6.0)
    K = np.array([[f, 0.0, cx], [0.0, f * 1.0005, cy], [0.0, 0.0, 1.0]])
    D = np.array([-0.22 + rng.normal(0.0, 0.01), 0.04 + rng.normal(0.0, 0.01), *rng.normal(0.0, 7e-4, 2), 0.0])
    return CameraModel(640, 480, K, D, rotation, -rotation @ centre)


def _place_lengths(rng: np.random.Generator, design: Design, cameras: tuple[CameraModel, ...]) -> KnownLengths:
    """A bar of half a metre, its middle in the inner half of the workspace, turned to any side."""
    low, high, k = np.array(design.workspace.low), np.array(design.workspace.high), design.lengths
    length, own = 0.5, 1e-4
    middle = (low + high) / 2.0 + rng.uniform(-0.25, 0.25, (k, 3)) * (high - low)
    half = random_rotations(rng, k)[:, :, 0] * length / 2.0
    ends = np.stack((middle - half, middle + half), axis=1)
    spots = np.stack([camera.project(ends.reshape(-1, 3)).reshape(k, 2, 2) for camera in cameras])
    spots = spots + rng.normal(0.0, design.sigma_px, spots.shape)
    inside = np.stack(
        [camera.contains(uv.reshape(-1, 2)).reshape(k, 2) for camera, uv in zip(cameras, spots, strict=True)]
    )
    spots[~inside] = np.nan
    stated = length + rng.normal(0.0, own, k)
    noise = np.tile(design.sigma_px**2 * np.eye(2), (*spots.shape[:3], 1, 1))
    return KnownLengths(stated, np.full(k, own), spots, noise)


def _covariances(rng: np.random.Generator, shape: tuple[int, ...], size: int, sigma: float, anisotropy: float) -> Array:
    """Random covariances whose mean variance is sigma^2."""
    shares = np.exp(rng.uniform(-0.5, 0.5, (*shape, size)) * 2.0 * np.log(anisotropy))
    shares *= sigma**2 / shares.mean(axis=-1, keepdims=True)
    axes = np.linalg.qr(rng.normal(size=(*shape, size, size)))[0]
    return np.asarray((axes * shares[..., None, :]) @ np.swapaxes(axes, -1, -2))


def _spoil(rng: np.random.Generator, kind: str, i: int, spots: Array, measured: Array, outliers: Mask) -> None:
    """Turn a spot or a whole pose into a gross outlier."""
    camera = int(rng.integers(len(spots)))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    if kind == "stale":
        direction = rng.normal(size=3)
        measured[i] += direction / np.linalg.norm(direction) * rng.uniform(0.03, 0.10)
        outliers[:, i] = True
    elif kind == "bias":
        spots[camera, i] += rng.uniform(2.0, 10.0) * np.array([np.cos(angle), np.sin(angle)])
        outliers[camera, i] = True
    else:
        spots[camera, i] = rng.uniform((0.0, 0.0), (639.0, 479.0))
        outliers[camera, i] = True


def bent(scene: SyntheticScene, kind: str, size_m: float, seed: int, *, kinematics: bool = False) -> SyntheticScene:
    """Bend the arm of a scene: positions with a smooth error, which the problem states as if it were noise.

    Args:
        scene: What to bend.
        kind: ``quadratic``, a polynomial of the place; ``links``, all kinematic parameters of an arm of six joints;
            ``gears``, joints that are off by a sine of one or two periods a turn.
        size_m: RMS error of each coordinate, but for what shifts or turns all positions alike [m].
        seed: Seed of the draw.
        kinematics: Whether the kinematics of the arm are given, and its noise is stated as 1 um.
    """
    rng, positions = np.random.default_rng((seed, 2)), scene.problem.positions
    away = positions - positions.mean(axis=0)
    if kind == "quadratic":
        error = np.einsum("nij,ijk->nk", away[:, :, None] * away[:, None, :], rng.normal(size=(3, 3, 3)))
    else:
        error = {"links": _links, "gears": _gears}[kind](rng, away, *_joints(away, scene.problem.wrist_rotations))
    turned = np.stack([np.cross(axis, away).ravel() for axis in np.eye(3)], axis=1)
    rigid = np.column_stack((turned, np.tile(np.eye(3), (len(away), 1))))
    error = error - (rigid @ np.linalg.lstsq(rigid, error.ravel(), rcond=None)[0]).reshape(-1, 3)
    error *= size_m / np.sqrt((error**2).mean())
    noise = np.tile((1e-6 if kinematics else size_m) ** 2 * np.eye(3), (len(positions), 1, 1))
    problem = replace(scene.problem, positions=positions + error, position_covariances=noise)
    if kinematics:
        problem = replace(problem, arm_jacobians=_kinematics(away, scene.problem.wrist_rotations))
    return replace(scene, problem=problem)


def _kinematics(away: Array, wrists: Array) -> Array:
    """Return the derivatives of the positions by turns, shifts and gears of joints, each of its usual size [m]."""
    angles, frames, origins = _joints(away, wrists)
    blocks = []
    for j in range(frames.shape[1]):
        turns = np.cross(np.swapaxes(frames[:, j], 1, 2), (away - origins[:, j])[:, None, :])
        waves = [wave(periods * angles[:, j]) for periods in (1, 2) for wave in (np.sin, np.cos)]
        gear = _GEAR_RAD * turns[:, 2, :, None] * np.stack(waves, axis=1)[:, None, :]
        blocks += [np.swapaxes(turns, 1, 2) * _TURNS_RAD, frames[:, j] * _SHIFT_M, gear]
    return np.concatenate(blocks, axis=2)


def _links(rng: np.random.Generator, away: Array, angles: Array, frames: Array, origins: Array) -> Array:
    """Displace each link by a small turn and shift, the zero of a joint more than the direction of its axis."""
    error = np.zeros_like(away)
    for j in range(angles.shape[1]):
        turn, shift = rng.normal(size=3) * _TURNS_RAD, _SHIFT_M * rng.normal(size=3)
        error += frames[:, j] @ shift + np.cross(frames[:, j] @ turn, away - origins[:, j])
    return error


def _gears(rng: np.random.Generator, away: Array, angles: Array, frames: Array, origins: Array) -> Array:
    error = np.zeros_like(away)
    for j in range(angles.shape[1]):
        periods, phase = rng.integers(1, 3), rng.uniform(0.0, 2.0 * np.pi)
        off = rng.normal() * np.sin(periods * angles[:, j] + phase)
        error += np.cross(off[:, None] * frames[:, j, :, 2], away - origins[:, j])
    return error


def _joints(away: Array, wrists: Array) -> tuple[Array, Array, Array]:
    """Angles, frames and origins of six joints, z along the axis, shapes (n, 6), (n, 6, 3, 3), (n, 6, 3).

    The arm has two links of 1.1 m, its base behind the workspace, and a wrist of three axes that meet 0.1 m behind the
    LED.
    """
    base, links = np.array([0.0, -1.0, -0.5]), np.array([1.1, 1.1])
    middle = away - 0.1 * wrists[:, :, 2]
    place = middle - base
    radius, height = np.hypot(place[:, 0], place[:, 1]), place[:, 2]
    reach = np.clip((radius**2 + height**2 - (links**2).sum()) / (2.0 * links.prod()), -1.0, 1.0)
    elbow = np.arccos(reach)
    shoulder = -np.arctan2(height, radius) - np.arctan2(links[1] * np.sin(elbow), links[0] + links[1] * np.cos(elbow))
    waist = np.arctan2(place[:, 1], place[:, 0])
    first = rotation_exp(np.outer(waist, (0.0, 0.0, 1.0)))
    upper = first @ rotation_exp(np.outer(shoulder, (0.0, 1.0, 0.0)))
    fore = upper @ rotation_exp(np.outer(elbow, (0.0, 1.0, 0.0)))
    hand = np.swapaxes(fore, 1, 2) @ wrists
    pan, tilt = np.arctan2(hand[:, 1, 2], hand[:, 0, 2]), np.arccos(np.clip(hand[:, 2, 2], -1.0, 1.0))
    panned = fore @ rotation_exp(np.outer(pan, (0.0, 0.0, 1.0)))
    tilted = panned @ rotation_exp(np.outer(tilt, (0.0, 1.0, 0.0)))
    rolled = np.swapaxes(tilted, 1, 2) @ wrists
    roll = np.arctan2(rolled[:, 1, 0], rolled[:, 0, 0])
    along = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]).T  # z where the axis y of a link is
    frames = np.stack((first, upper @ along, fore @ along, panned, tilted @ along, wrists), axis=1)
    start = np.tile(base, (len(away), 1))
    origins = np.stack((start, start, start + links[0] * upper[:, :, 0], middle, middle, middle), axis=1)
    return np.stack((waist, shoulder, elbow, pan, tilt, roll), axis=1), frames, origins
