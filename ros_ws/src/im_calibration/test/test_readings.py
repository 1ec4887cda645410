"""Positions that share a reading of the robot are off together: the stated errors hold, whatever number of spots."""

from dataclasses import replace

import numpy as np

from bench.calibration.score import deviations, errors
from bench.calibration.synthetic import Design, SyntheticScene, make_scene, random_rotations
from im_calibration import calibrate
from im_calibration.estimation.gates import predict_from_others
from im_calibration.estimation.projection import image
from im_calibration.estimation.search import first_explanation
from im_calibration.estimation.unknowns import ParameterLayout
from im_calibration.judgement import causes
from im_cell.calibration_error import rms

SIGMA_M = 4e-4


def shared_scene(seed, *, readings=20, each=4, sigma_m=SIGMA_M) -> SyntheticScene:
    """Several lights on the wrist, all seen at each of some poses, all off by the error of the robot's reading."""
    design, rng = Design(poses=readings * each, sigma_m=1e-7), np.random.default_rng((seed, 9))
    where = rng.uniform(design.workspace.low, design.workspace.high, (readings, 3))
    wrists, lights = random_rotations(rng, readings), rng.uniform(-0.1, 0.1, (each, 3))
    places = (where[:, None] + np.einsum("nij,kj->nki", wrists, lights)).reshape(-1, 3)
    scene = make_scene(design, seed, places, np.repeat(wrists, each, axis=0))
    off = np.repeat(rng.normal(0.0, sigma_m, (readings, 3)), each, axis=0)
    problem = replace(
        scene.problem,
        positions=scene.problem.positions + off,
        position_covariances=np.tile(SIGMA_M**2 * np.eye(3), (len(places), 1, 1)),
        readings=tuple(str(number) for number in np.repeat(np.arange(readings), each)),
    )
    return replace(scene, problem=problem)


def test_errors_are_as_expected_with_four_spots_a_reading():
    found, expected, within, good = [], [], [], 0
    for seed in range(800, 803):
        scene = shared_scene(seed)
        calibration = calibrate(scene.problem)
        good += calibration.success
        found.append(errors(tuple(camera.model for camera in calibration.cameras), scene)[0])
        expected.append(calibration.expected.reprojection_rms_px)
        within.append(np.abs(deviations(calibration, scene)) < 2.0 * calibration.standard_deviations)
    assert 0.8 < rms(np.array(found)) / rms(np.array(expected)) < 1.3
    assert np.mean(within) > 0.9
    assert good >= 2


def test_the_order_of_poses_and_the_names_of_readings_do_not_matter():
    problem = shared_scene(1, readings=12, each=3).problem
    shuffled = problem.taking(np.random.default_rng(0).permutation(len(problem.positions)))
    renamed = replace(shuffled, readings=tuple(f"reading {99 - int(label)}" for label in shuffled.readings))
    one, other = calibrate(problem), calibrate(renamed)
    for camera, same in zip(one.cameras, other.cameras, strict=True):
        np.testing.assert_allclose(camera.model.K, same.model.K, rtol=1e-7)
        np.testing.assert_allclose(camera.covariance, same.covariance, rtol=1e-3, atol=1e-12)


def test_readings_of_one_pose_each_are_none():
    problem = make_scene(Design(poses=20), 3).problem
    alone = replace(problem, readings=tuple(f"r{number:02}" for number in range(20)))
    for camera, same in zip(calibrate(problem).cameras, calibrate(alone).cameras, strict=True):
        np.testing.assert_array_equal(camera.model.K, same.model.K)


def test_a_reading_is_predicted_from_the_others_with_its_error_unknown():
    """As is the fit without the reading: its spots say nothing of the error that they share."""
    problem = shared_scene(2, readings=12, each=3).problem
    layout = ParameterLayout.of(problem)
    gated = first_explanation(problem, layout)
    prediction = predict_from_others(gated.fit, problem, layout, problem.detected)
    out = problem.poses_of_readings[5]
    rest = problem.taking(np.delete(np.arange(36), out))
    fit = first_explanation(rest, ParameterLayout.of(rest)).fit
    unknowns = replace(fit.unknowns, displacements=np.zeros((36, 3)), shared_errors=np.zeros(layout.shared))
    away = problem.spots - image(unknowns, unknowns.robot_positions(problem))
    for camera in range(2):
        np.testing.assert_allclose(
            prediction.errors[out, 2 * camera : 2 * camera + 2], away[camera, out], atol=0.05, rtol=0.05
        )


def test_a_stale_reading_is_left_out_whole_and_a_wrong_spot_alone():
    scene = shared_scene(3)
    positions, spots = scene.problem.positions.copy(), scene.problem.spots.copy()
    positions[8:12] += 0.05
    spots[0, 41] += 8.0
    calibration = calibrate(replace(scene.problem, positions=positions, spots=spots))
    assert calibration.success, calibration.message
    assert not calibration.used[:, 8:12].any()
    assert not calibration.used[0, 41]
    assert (scene.problem.detected & ~calibration.used).sum() <= scene.problem.detected[:, 8:12].sum() + 3


def test_the_noise_of_readings_is_found_where_it_is_not_stated():
    problem = shared_scene(12, sigma_m=2.0 * SIGMA_M).problem
    factor = calibrate(replace(problem, noise_to_estimate=("robot",))).noise.factors.robot
    assert factor.low < 2.0 < factor.high
    assert factor.high / factor.low < 2.0


def test_a_robot_that_was_moved_between_readings_of_several_spots_is_found():
    problem = shared_scene(3, readings=20, each=2).problem
    moved = np.where(np.arange(len(problem.positions))[:, None] < 20, 0.0, [0.1, 0.0, 0.0])
    told = causes._moved(replace(problem, positions=problem.positions + moved), None)
    assert told.startswith("From pose 20 on the LED positions are off by (100, 0, ")
