"""The true simulated cell: arms, cameras, lights and laser, drawn off the nominal values."""

import numpy as np
from numpy.typing import NDArray

from im_cell.robot import Camera, Cell, LaserScanner, Vector
from im_cell.robot.arm_errors import usual_errors
from im_cell.robot.truth import CameraTruth, CellTruth, JointTruth, LaserTruth, LedTruth, Matrix, tool_errors
from im_cell.rotations import matrix_of_vector

FOCAL_SPREAD = 0.02
ASPECT_SPREAD = 0.001
PRINCIPAL_POINT_SPREAD_PX = 8.0
POSITION_SPREAD_M = 0.03
ANGLE_SPREAD_RAD = np.deg2rad(2.0)
LED_OFFSET_SD_M = 0.003
RADIAL_MEAN, RADIAL_SD = (-0.22, 0.04), (0.01, 0.004)
TANGENTIAL_SD = 7e-4
TOOL_ERROR_M = (0.3e-3, 1e-3)


def draw_truth(cell: Cell, seed: int, *, perfect_arm: bool = False) -> CellTruth:
    """The true cell of a seed.

    Joints are turned, shifted and geared a little off the drawing, each error normal and of its usual size, times one
    factor for each arm: the tool is off by 0.3 to 1 mm, RMS over its reach. A perfect arm is as drawn.

    Focal lengths, principal points and poses are uniform within their spreads, distortion and light offsets normal.
    The laser scanner is mounted as well as the cameras are, its mirrors are within the tolerances of its data sheet.
    Every arm, camera and light has a random stream of its own, so that adding one changes no other.
    """
    cameras = {name: _camera(camera, _stream(seed, f"camera {name}")) for name, camera in cell.cameras.items()}
    leds = {}
    for name in cell.light_names:
        offset = np.array(cell.led.offset) + _stream(seed, f"light {name}").normal(0.0, LED_OFFSET_SD_M, 3)
        leds[name] = LedTruth(offset_m=_vector(offset), axis=cell.led.axis, diameter_m=cell.led.diameter)
    return CellTruth(
        seed=seed,
        cameras=cameras,
        leds=leds,
        laser=_laser(cell.laser, _stream(seed, "laser")) if cell.laser else None,
        joints={} if perfect_arm else {k: v for group in cell.groups for k, v in _arm(cell, group, seed).items()},
    )


def _arm(cell: Cell, group: str, seed: int) -> dict[str, JointTruth]:
    """Draw the errors of the joints of a group."""
    rng, joints = _stream(seed, f"arm {group}"), [each for each in cell.joints if each.name in cell.joints_of(group)]
    drawn = {joint: rng.normal(size=len(usual_errors(joint))) for joint in joints}
    size, usual = rng.uniform(*TOOL_ERROR_M), {joint.name: JointTruth.of(joint, drawn[joint]) for joint in joints}
    factor = size / np.sqrt(np.mean(tool_errors(cell, group, usual, rng) ** 2))
    return {joint.name: JointTruth.of(joint, factor * drawn[joint]) for joint in joints}


def _camera(camera: Camera, rng: np.random.Generator) -> CameraTruth:
    lens = camera.intrinsics
    scale = 1.0 + rng.uniform(-FOCAL_SPREAD, FOCAL_SPREAD)
    fx = lens.fx * scale
    fy = lens.fy * scale * (1.0 + rng.uniform(-ASPECT_SPREAD, ASPECT_SPREAD))
    cx, cy = np.array([lens.cx, lens.cy]) + rng.uniform(-PRINCIPAL_POINT_SPREAD_PX, PRINCIPAL_POINT_SPREAD_PX, 2)
    k1, k2 = rng.normal(RADIAL_MEAN, RADIAL_SD)
    p1, p2 = rng.normal(0.0, TANGENTIAL_SD, 2)
    rotation, translation = camera.pose()
    position = -rotation.T @ translation + rng.uniform(-POSITION_SPREAD_M, POSITION_SPREAD_M, 3)
    rotation = matrix_of_vector(rng.uniform(-ANGLE_SPREAD_RAD, ANGLE_SPREAD_RAD, 3)) @ rotation
    return CameraTruth(
        parent=camera.parent,
        width=lens.width,
        height=lens.height,
        K=_matrix(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])),
        D=(float(k1), float(k2), float(p1), float(p2), 0.0),
        R_cam_base=_matrix(rotation),
        t_cam_base_m=_vector(-rotation @ position),
    )


def _laser(scanner: LaserScanner, rng: np.random.Generator) -> LaserTruth:
    rotation, position = scanner.pose()
    position = position + rng.uniform(-POSITION_SPREAD_M, POSITION_SPREAD_M, 3)
    rotation = matrix_of_vector(rng.uniform(-ANGLE_SPREAD_RAD, ANGLE_SPREAD_RAD, 3)) @ rotation
    first, second = 1.0 + rng.normal(0.0, scanner.tolerance.gain, 2)
    return LaserTruth(
        rotation=_matrix(rotation),
        position_m=_vector(position),
        gain=(float(first), float(second)),
        offset=float(rng.normal(0.0, scanner.tolerance.offset)),
        gap_m=float(scanner.gap + rng.normal(0.0, scanner.tolerance.gap)),
    )


def _stream(seed: int, name: str) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(np.random.SeedSequence([seed & 0xFFFFFFFFFFFFFFFF, *name.encode()])))


def _vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _matrix(values: NDArray[np.float64]) -> Matrix:
    first, second, third = (_vector(row) for row in values)
    return first, second, third
