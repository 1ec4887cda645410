"""Several looks of a robot that stays: their spots are averaged, and the error of the arm is not."""

from dataclasses import replace

import numpy as np
import pytest

from bench.calibration.asked_accuracy import CAMERAS
from im_calibration import Observation, SeenSpot, calibrate
from im_cell.camera_model import nominal
from im_cell.robot import load_cell
from im_cell.rotations import matrix_of_quaternion
from im_dispatcher.job import problem_of_light
from im_dispatcher.poses_file import load_named_poses

ARM_M, SPOT_PX = 3e-4, 0.02


def looked(looks: int, seed: int = 5) -> list[Observation]:
    """Observations of the shipped poses by nominal cameras: an arm that is off at each pose, and noise of each spot."""
    rng, cell = np.random.default_rng(seed), load_cell()
    cameras = {name: nominal(cell.cameras[name]) for name in CAMERAS}
    found = []
    for pose in load_named_poses("").poses:
        rotation, position = matrix_of_quaternion(pose.orientation_xyzw), np.array(pose.position_m)
        light = (position + rotation @ np.array(cell.led.offset))[None]
        measured = position + rng.normal(0.0, ARM_M, 3)
        for look in range(looks):
            seen = {
                name: SeenSpot(camera.project(light)[0] + rng.normal(0.0, SPOT_PX, 2), SPOT_PX**2 * np.eye(2), 1)
                for name, camera in cameras.items()
            }
            encoders = measured + rng.normal(0.0, 1e-6, 3)
            found.append(Observation(f"{pose.name}/{look}", encoders, rotation, ARM_M**2 * np.eye(3), seen))
    return found


def test_looks_of_a_robot_that_stays_are_one_reading_and_others_are_not():
    assert problem_of_light(CAMERAS, looked(1)).readings == ()
    three = problem_of_light(CAMERAS, looked(3)).readings
    assert [three.count(label) for label in dict.fromkeys(three)] == [3] * 40
    first, second, *_ = looked(1)
    moved = replace(first, pose="moved", position=first.position + np.array([2e-4, 0.0, 0.0]))
    assert problem_of_light(CAMERAS, [first, moved, second]).readings == ()


def test_more_looks_at_the_same_poses_promise_no_better_arm():
    """Counted as positions of their own, four looks would promise half of the error."""
    once, often = (
        calibrate(problem_of_light(CAMERAS, looked(count))).expected.triangulation_rms_mm for count in (1, 4)
    )
    assert often == pytest.approx(once, rel=0.25)
