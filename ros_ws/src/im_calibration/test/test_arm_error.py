"""Error of an arm that is smooth over its space: found, taken for what it is, and in everything stated."""

from dataclasses import replace

import numpy as np
import pytest

from bench.calibration.score import deviations, errors
from bench.calibration.synthetic import Design, bent, make_scene, random_rotations
from im_calibration import calibrate
from im_calibration.estimation.arm import with_arm_error
from im_calibration.estimation.chi_squared import chi2_limit
from im_calibration.estimation.search import first_explanation
from im_calibration.estimation.unknowns import ParameterLayout
from im_calibration.judgement.checks import check
from im_calibration.problem.arm_error import ArmError
from im_cell.calibration_error import rms


def scored(kind, size_m, poses, seeds):
    """Errors over those expected, and the share of parameters within two deviations."""
    found, expected, within = [], [], []
    for seed in seeds:
        scene = bent(make_scene(Design(poses=poses, sigma_m=1e-7), seed), kind, size_m, seed)
        calibration = calibrate(scene.problem)
        assert calibration.success, calibration.message
        found.append(errors(tuple(camera.model for camera in calibration.cameras), scene)[0])
        expected.append(calibration.expected.reprojection_rms_px)
        within.append(np.abs(deviations(calibration, scene)) < 2.0 * calibration.standard_deviations)
    return rms(np.array(found)) / rms(np.array(expected)), float(np.mean(within))


@pytest.mark.parametrize(("kind", "size_m", "poses"), [("quadratic", 3e-4, 60), ("links", 1e-3, 40)])
def test_errors_are_as_expected_where_the_arm_is_bent(kind, size_m, poses):
    ratio, within = scored(kind, size_m, poses, range(700, 703))
    assert 0.5 < ratio < 1.6  # three seeds
    assert within > 0.8


@pytest.mark.parametrize(("size_m", "poses"), [(3e-4, 40), (1e-3, 20)])
def test_errors_are_as_expected_where_the_kinematics_of_a_bent_arm_are_given(size_m, poses):
    found, expected = [], []
    for seed in range(710, 713):
        scene = bent(make_scene(Design(poses=poses, sigma_m=1e-7), seed), "links", size_m, seed, kinematics=True)
        calibration = calibrate(scene.problem)
        assert calibration.success, calibration.message
        assert calibration.used.all() == scene.problem.detected.all()
        found.append(errors(tuple(camera.model for camera in calibration.cameras), scene)[0])
        expected.append(calibration.expected.reprojection_rms_px)
    assert 0.4 < rms(np.array(found)) / rms(np.array(expected)) < 1.7  # three seeds


def test_more_poses_of_a_bent_arm_do_not_make_it_straight():
    scene = bent(make_scene(Design(poses=100, sigma_m=1e-7), 1), "quadratic", 1e-3, 1)
    calibration = calibrate(scene.problem)
    assert 5e-4 < calibration.arm_error_m < 2e-3
    assert "error of the arm" in calibration.message


def repeating(scene, noise_m, seed):
    """The same scene, the robot's noise drawn and stated as that to which it repeats a place."""
    positions, rng = scene.problem.positions, np.random.default_rng((seed, 9))
    noise = np.tile(noise_m**2 * np.eye(3), (len(positions), 1, 1))
    positions = positions + noise_m * rng.normal(size=positions.shape)
    return replace(scene, problem=replace(scene.problem, positions=positions, position_covariances=noise))


@pytest.mark.parametrize(("kind", "poses"), [("quadratic", 20), ("links", 40), ("gears", 100)])
def test_regions_hold_the_truth_where_one_camera_takes_up_the_error_of_an_arm(kind, poses):
    within = []
    for seed in range(6):
        scene = make_scene(Design(poses=poses, cameras=1, sigma_m=1e-7), seed)
        scene = repeating(bent(scene, kind, 3e-4, seed), 2e-5, seed)
        calibration = calibrate(scene.problem)
        assert calibration.success, calibration.message
        off, block = deviations(calibration, scene)[:14], calibration.covariance[:14, :14]
        within.append(off @ np.linalg.solve(block, off) < chi2_limit(0.05, 14))
    assert np.mean(within) > 0.6


def test_many_poses_with_the_bare_noise_of_an_arm_show_no_error():
    assert [calibrate(make_scene(Design(poses=400), seed).problem).arm_error_m for seed in range(40, 42)] == [0.0] * 2


def test_a_robot_said_to_be_off_by_no_more_than_arms_repeat_a_place_has_an_error():
    for seed in range(46, 49):
        scene = make_scene(Design(poses=30, cameras=1, sigma_m=1e-7), seed)
        told, exact = (calibrate(repeating(scene, noise_m, seed).problem).arm_error_m for noise_m in (3e-5, 0.0))
        assert told > 2.0 * exact


def test_noise_larger_than_stated_is_not_taken_for_an_arm():
    problem = make_scene(Design(), 45).problem.with_noise(0.3, 0.3)
    fit = first_explanation(problem, ParameterLayout.of(problem))
    assert with_arm_error(fit, problem).problem.arm_error is None


def test_a_robot_of_which_nothing_is_stated_has_an_error_of_the_arm():
    problem = make_scene(Design(poses=25, cameras=1), 46).problem
    stated = calibrate(problem)
    unknown = calibrate(replace(problem, noise_to_estimate=("robot",)))
    assert stated.arm_error_m < 0.8 * unknown.arm_error_m
    assert np.all(unknown.cameras[0].standard_deviations > stated.cameras[0].standard_deviations)


def test_a_half_of_the_space_that_contradicts_the_other_is_seen_unless_it_is_the_arm():
    problem = bent(make_scene(Design(poses=60, sigma_m=1e-7), 47), "quadratic", 2e-3, 47).problem
    small = replace(problem, position_covariances=1e-8 * np.tile(np.eye(3), (60, 1, 1)))
    straight = first_explanation(small, ParameterLayout.of(small))
    assert check(straight, small, ParameterLayout.of(small)).far_half_p_value < 1e-3
    found = with_arm_error(straight, small)
    assert check(found.gated, found.problem, found.layout).far_half_p_value > 1e-3


def test_no_part_of_the_error_shifts_or_turns_all_positions_alike():
    positions = np.random.default_rng(3).uniform(1.0, 3.0, (30, 3))
    error = ArmError.largest(positions, random_rotations(np.random.default_rng(3), 30))
    away = positions - positions.mean(axis=0)
    np.testing.assert_allclose(error.jacobians.sum(axis=0), 0.0, atol=1e-12)
    turned = np.cross(away[:, None, :], np.swapaxes(error.jacobians, 1, 2)).sum(axis=0)
    np.testing.assert_allclose(turned, 0.0, atol=1e-12)


def test_a_tool_that_swings_on_a_bent_wrist_is_in_the_error():
    rng = np.random.default_rng(7)
    positions, wrists = rng.uniform(-1.0, 1.0, (60, 3)), random_rotations(rng, 60)
    swung = np.cross([1.0, 2.0, -1.0], wrists @ [0.1, 0.2, 0.1]).ravel()
    turned = np.cross(np.eye(3)[:, None], positions).reshape(3, -1)
    spanned = np.vstack(
        (turned, np.tile(np.eye(3), 60), ArmError.largest(positions, wrists).jacobians.reshape(180, -1).T)
    )
    left = swung - spanned.T @ np.linalg.lstsq(spanned.T, swung, rcond=None)[0]
    assert np.linalg.norm(left) < 1e-6 * np.linalg.norm(swung)


def test_the_error_does_not_depend_on_axes_or_units():
    positions = np.random.default_rng(4).uniform(-1.0, 1.0, (12, 3))
    wrists, turn = random_rotations(np.random.default_rng(5), 12), random_rotations(np.random.default_rng(6), 1)[0]

    def spread(places, rotations):
        jacobians = ArmError.largest(places, rotations).jacobians.reshape(36, -1)
        return jacobians @ jacobians.T

    one, other = spread(positions, wrists), spread(1e3 * positions @ turn.T, turn @ wrists)
    whole = np.kron(np.eye(12), turn)
    np.testing.assert_allclose(other, 1e6 * whole @ one @ whole.T, atol=1e-9)
