"""Noise that is not as stated: found, told, taken into account; what cannot be told apart is said to be so."""

from dataclasses import replace

import numpy as np
import pytest

from bench.calibration.synthetic import Design, make_scene
from im_calibration import calibrate, report_of
from im_calibration.estimation.noise import NoiseLikelihood, noise_factors
from im_calibration.estimation.residuals import linearise
from im_calibration.estimation.solve import maximise_likelihood, robust_fit
from im_calibration.estimation.start import start
from im_calibration.estimation.unknowns import ParameterLayout
from im_cell.calibration_summary import summary

EVERYTHING = Design(poses=14, anisotropy=3.0, joint_offset_prior_sd=0.003, missing_share=0.1)
BOTH = ("image", "robot")


def holds(factor, true):
    return factor.low <= true <= factor.high


@pytest.fixture(scope="module")
def fitted():
    problem = make_scene(EVERYTHING, 4).problem
    layout = ParameterLayout.of(problem)
    first = robust_fit(start(problem, layout), problem, layout, problem.detected)
    return problem, layout, maximise_likelihood(first.unknowns, problem, layout, problem.detected)


def dense_deviance(problem, layout, unknowns, image, robot):
    """Minus twice the restricted log-likelihood from whole matrices, by the textbook."""
    line = linearise(unknowns, problem, layout, problem.detected)
    rows = np.repeat(problem.detected.T, 2, axis=1).ravel()
    n, m = line.residuals.shape
    stated = np.zeros((2, n * m, n * m))
    for i in range(n):
        block = slice(m * i, m * (i + 1))
        by_robot = line.by_point[i] @ problem.position_covariances[i] @ line.by_point[i].T
        stated[0, block, block], stated[1, block, block] = line.covariances[i] - by_robot, by_robot
    spread = (image * stated[0] + robot * stated[1])[np.ix_(rows, rows)]
    jacobian, residuals = line.jacobians.reshape(n * m, -1)[rows], line.residuals.ravel()[rows]
    prior = layout.prior(unknowns)
    weights = np.linalg.inv(spread)
    information = jacobian.T @ weights @ jacobian + prior.information
    step = np.linalg.solve(information, jacobian.T @ weights @ residuals + prior.gradient)
    left = residuals - jacobian @ step
    logs = np.linalg.slogdet(spread)[1] + np.linalg.slogdet(information)[1]
    return logs + left @ weights @ left + step @ prior.information @ step - 2.0 * prior.gradient @ step


def test_the_likelihood_is_that_of_whole_matrices(fitted):
    problem, layout, fit = fitted
    likelihood = NoiseLikelihood(fit.unknowns, problem, layout, problem.detected)
    pairs = [(1.0, 1.0), (0.1, 3.0), (20.0, 0.5)]
    ours = [likelihood.deviance(np.log(pair)) for pair in pairs]
    theirs = [dense_deviance(problem, layout, fit.unknowns, *pair) for pair in pairs]
    np.testing.assert_allclose(np.diff(ours), np.diff(theirs), rtol=1e-4)


def test_its_slope_is_its_derivative(fitted):
    problem, layout, fit = fitted
    likelihood = NoiseLikelihood(fit.unknowns, problem, layout, problem.detected)
    for logs in np.log([(1.0, 1.0), (0.1, 3.0), (20.0, 0.5)]):
        steps = 1e-4 * np.eye(2)
        by_differences = [(likelihood.deviance(logs + s) - likelihood.deviance(logs - s)) / 2e-4 for s in steps]
        np.testing.assert_allclose(likelihood.slope(logs)[0], by_differences, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("image", "robot"), [(0.3, 0.3), (10.0, 1.0), (0.3, 10.0)])
def test_both_factors_are_found_whatever_is_stated(image, robot):
    problem = make_scene(Design(outlier_share=0.1), 21).problem.with_noise(1.0 / image, 1.0 / robot)
    calibration = calibrate(replace(problem, noise_to_estimate=BOTH))
    factors = calibration.noise.factors
    assert calibration.success
    assert factors.separable
    assert holds(factors.image, image)
    assert holds(factors.robot, robot)
    assert "Estimated noise: of the image 0." in calibration.message


def test_what_is_stated_of_the_size_of_noise_that_is_estimated_makes_no_difference():
    scene = make_scene(Design(outlier_share=0.1), 22)
    found = [
        calibrate(replace(scene.problem.with_noise(*factors), noise_to_estimate=BOTH))
        for factors in ((1.0, 1.0), (20.0, 5.0))
    ]
    np.testing.assert_array_equal(found[1].used, found[0].used)
    np.testing.assert_allclose(found[1].cameras[1].model.K, found[0].cameras[1].model.K, rtol=1e-3)
    np.testing.assert_allclose(found[1].standard_deviations, found[0].standard_deviations, rtol=0.05)
    assert not np.any(found[0].used & scene.outliers)


def test_one_camera_cannot_tell_the_robots_noise_from_its_own():
    problem = make_scene(Design(cameras=1), 23).problem.with_noise(0.1, 0.1)
    calibration = calibrate(replace(problem, noise_to_estimate=BOTH))
    factors = calibration.noise.factors
    assert not factors.separable
    assert factors.image.low == factors.robot.low == 0.0
    assert holds(factors.image, 10.0)
    assert holds(factors.robot, 10.0)
    assert holds(factors.common, 10.0)
    assert "cannot be told" in calibration.message


@pytest.mark.parametrize(("stated", "words"), [((3.0, 3.0), "too large"), ((3.0, 1.0), "that of the image")])
def test_noise_that_is_stated_too_large_is_told(stated, words):
    calibration = calibrate(make_scene(Design(), 24).problem.with_noise(*stated))
    assert calibration.success
    assert calibration.p_value > 0.999
    assert "The stated noise is about" in calibration.message
    assert words in calibration.message
    assert holds(calibration.noise.factors.image, 1.0 / 3.0)


def test_noise_that_is_stated_too_small_is_a_misfit_and_told():
    calibration = calibrate(make_scene(Design(), 25).problem.with_noise(1.0 / 3.0, 1.0 / 3.0))
    assert [verdict.kind for verdict in calibration.verdicts] == ["MISFIT"]
    assert calibration.p_value < 1e-3
    assert calibration.cause == ""
    assert "If nothing else is wrong: The stated noise is about" in calibration.message
    assert "too small" in calibration.message
    assert holds(calibration.noise.factors.common, 3.0)


def test_of_noise_as_stated_nothing_is_said():
    calibration = calibrate(make_scene(Design(), 26).problem)
    assert calibration.noise.remark == ""
    assert holds(calibration.noise.factors.image, 1.0)


def test_positions_that_are_exact_leave_the_image_alone():
    problem = make_scene(Design(sigma_m=1e-9, led_offset_prior_sd=0.0), 29).problem
    exact = replace(problem.with_noise(5.0, 0.0), noise_to_estimate=BOTH)
    calibration = calibrate(exact)
    assert holds(calibration.noise.factors.image, 0.2)
    assert "of the robot" not in calibration.noise.remark


def test_eight_poses_say_little_about_noise():
    problem = make_scene(Design(poses=8, cameras=1, led_offset_prior_sd=0.0), 3).problem
    layout = ParameterLayout.of(problem)
    fit = robust_fit(start(problem, layout), problem, layout, problem.detected)
    factors = noise_factors(fit.unknowns, problem, layout, problem.detected)
    assert not factors.separable
    assert factors.common.high > 2.0 * factors.common.low


def test_the_report_tells_the_noise():
    problem = make_scene(Design(cameras=1), 28).problem
    report = report_of(calibrate(replace(problem, noise_to_estimate=("image",))), problem)
    noise = report["noise"]
    assert noise["estimated"] == ["image"]
    assert noise["sigma_image_px"] == pytest.approx(0.1, rel=0.4)
    assert noise["robot"] == {"factor": 1.0, "low": 1.0, "high": 1.0}
    assert "estimated (image)" in summary(report)


@pytest.mark.parametrize("slip", ["transposed", "shifted"])
def test_noise_that_no_arm_has_is_a_misfit_also_where_it_is_estimated(slip):
    problem = make_scene(Design(poses=60, cameras=1, led_offset_prior_sd=0.1), 31).problem
    rotations = problem.wrist_rotations
    wrong = np.swapaxes(rotations, 1, 2) if slip == "transposed" else np.roll(rotations, 1, axis=0)
    calibration = calibrate(replace(problem, wrist_rotations=wrong, noise_to_estimate=BOTH))
    assert [verdict.kind for verdict in calibration.verdicts] == ["MISFIT"]


def test_residuals_of_a_robot_that_is_bent_are_told_from_noise():
    problem = make_scene(Design(poses=100, cameras=1), 30).problem
    honest = calibrate(replace(problem, noise_to_estimate=BOTH))
    x = problem.positions
    bent = x + 5e-3 * np.sin(5.0 * x[:, [1, 2, 0]])
    spoiled = calibrate(replace(problem, positions=bent, noise_to_estimate=BOTH))
    assert not honest.neighbours.alike
    assert [verdict.kind for verdict in spoiled.verdicts] == ["MISFIT"]
    assert "more than the error of an arm" in spoiled.message
