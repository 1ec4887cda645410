"""How long a calibration to a stated accuracy takes, and how true its expected error is, beside all shipped poses."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from im_calibration import Observation, SeenSpot, calibrate
from im_calibration.estimation.unknowns import rotation_exp
from im_cell.calibration_error import evaluate
from im_cell.camera_model import CameraModel, nominal
from im_cell.robot import load_cell
from im_cell.rotations import matrix_of_quaternion
from im_cell.visit_order import leg_times
from im_dispatcher.accuracy import LOOK_S, REST_S, next_visits
from im_dispatcher.job import problem_of_light
from im_dispatcher.poses_file import PosesFile, load_named_poses

CAMERAS = ("ceiling_left", "ceiling_right")
_SPOT_PX, _POSITION_M = 0.032, 1.5e-6


@dataclass(frozen=True)
class Reached:
    """End of a calibration: poses and looks, estimated time [s], expected and true RMS triangulation error [mm]."""

    poses: int
    looks: int
    seconds: float
    expected_mm: float
    true_mm: float


def asked_accuracy(seed: int, accuracy_m: float) -> Reached:
    """Calibrate to an accuracy in a world without images: true cameras as a seed draws them about the nominal ones."""
    rng, file = np.random.default_rng(seed), load_named_poses("")
    truth = [_drawn(rng, nominal(load_cell().cameras[name])) for name in CAMERAS]
    offset = np.array(load_cell().led.offset) + rng.normal(0.0, load_cell().led.offset_prior_sd, 3)
    observed: dict[int, list[Observation]] = {}
    visited: list[int] = []
    while visits := next_visits(file, CAMERAS, accuracy_m, observed, (), ()).poses:
        for pose in dict.fromkeys(visits):
            visited.append(pose)
            observed[pose] = [seen(rng, file, pose, look, truth, offset) for look in range(visits.count(pose))]
    everything = [each for looks in observed.values() for each in looks]
    problem = problem_of_light(CAMERAS, everything)
    calibration = calibrate(problem)
    error = evaluate([camera.model for camera in calibration.cameras], truth, problem.workspace.grid())
    expected = calibration.expected.triangulation_rms_mm
    seconds = seconds_of(file, visited, len(everything))
    return Reached(len(observed), len(everything), seconds, expected, error.triangulation_rms_mm)


def seconds_of(file: PosesFile, visited: Sequence[int], looks: int) -> float:
    """Return the estimated time from home through poses, by their numbers from 1, with some looks in all [s]."""
    cell = load_cell()
    places = np.array([cell.groups[file.group].home, *(file.poses[number - 1].joints for number in visited)])
    motions = leg_times(cell, list(cell.joints_of(file.group)), places).diagonal(1)
    return float(motions.sum()) + REST_S * len(visited) + LOOK_S * looks


def _drawn(rng: np.random.Generator, camera: CameraModel) -> CameraModel:
    """A camera near to a nominal one, with a lens."""
    turn = rotation_exp(rng.normal(0.0, 0.01, (1, 3)))[0] @ camera.R_cam_base
    K = camera.K * np.array([[1.0 + rng.normal(0.0, 0.01)], [1.0 + rng.normal(0.0, 0.01)], [1.0]])
    D = np.array([-0.2 + rng.normal(0.0, 0.02), 0.04 + rng.normal(0.0, 0.01), *rng.normal(0.0, 5e-4, 2), 0.0])
    return replace(camera, K=K, D=D, R_cam_base=turn, t_cam_base=camera.t_cam_base + rng.normal(0.0, 0.01, 3))


def seen(
    rng: np.random.Generator, file: PosesFile, number: int, look: int, truth: list[CameraModel], offset: np.ndarray
) -> Observation:
    """What cameras see of the light at a pose, by its number from 1, with noise of spots and positions."""
    pose = file.poses[number - 1]
    rotation, position = matrix_of_quaternion(pose.orientation_xyzw), np.array(pose.position_m)
    light = (position + rotation @ offset)[None]
    spots = {}
    for name, camera in zip(CAMERAS, truth, strict=True):
        pixel = camera.project(light)
        if camera.contains(pixel)[0]:
            uv = pixel[0] + rng.normal(0.0, _SPOT_PX, 2)
            spots[name] = SeenSpot(uv, _SPOT_PX**2 * np.eye(2), 1)
    measured = position + rng.normal(0.0, _POSITION_M, 3)
    return Observation(f"{pose.name}/{look}", measured, rotation, _POSITION_M**2 * np.eye(3), spots)
