"""Known lengths: they reveal a wrong scale of the robot, which nothing else does."""

from dataclasses import replace

import numpy as np
import pytest

from bench.calibration.synthetic import Design, make_scene
from im_calibration import calibrate, report_of
from im_cell.calibration_summary import summary


@pytest.mark.parametrize("error", [0.01, -0.01])
def test_a_scale_error_of_a_percent_is_found_and_measured(error):
    problem = make_scene(Design(scale_error=error, lengths=10), 1).problem
    calibration = calibrate(problem)
    scale = calibration.scale
    assert abs(scale.error - error) < 4.0 * scale.standard_deviation < 0.005
    assert {(v.kind, v.parameters) for v in calibration.verdicts} == {("MISFIT", ("robot.scale",))}
    assert "robot's scale" in summary(report_of(calibration, problem))


def test_no_residual_shows_it():
    right, wrong = (calibrate(make_scene(Design(scale_error=error), 5).problem) for error in (0.0, 0.01))
    assert wrong.success
    assert wrong.scale is None
    assert wrong.chi2 == pytest.approx(right.chi2, rel=0.02)


def test_the_camera_that_follows_from_the_factor_is_the_true_one():
    scene = make_scene(Design(scale_error=0.01, lengths=12, led_offset_prior_sd=0.0), 6)
    calibration = calibrate(scene.problem)
    for estimate, true in zip(calibration.cameras, scene.cameras, strict=True):
        miss = np.linalg.norm(estimate.model.t_cam_base - true.t_cam_base)
        mended = np.linalg.norm(estimate.model.t_cam_base * (1.0 + calibration.scale.error) - true.t_cam_base)
        assert mended < miss


def test_the_error_of_the_scale_is_as_stated():
    found = [calibrate(make_scene(Design(lengths=4), seed).problem) for seed in range(40, 46)]
    normal = np.array([c.scale.error / c.scale.standard_deviation for c in found])
    assert np.abs(normal).max() < 3.5
    assert 0.5 < np.sqrt(np.mean(normal**2)) < 1.6
    assert all(c.success for c in found)


def test_the_order_of_the_lengths_does_not_matter():
    problem = make_scene(Design(lengths=6), 7).problem
    lengths = problem.lengths
    turned = replace(
        lengths,
        lengths=lengths.lengths[::-1],
        standard_deviations=lengths.standard_deviations[::-1],
        spots=lengths.spots[:, ::-1],
        spot_covariances=lengths.spot_covariances[:, ::-1],
    )
    assert calibrate(problem).scale == calibrate(replace(problem, lengths=turned)).scale


def test_lengths_that_contradict_each_other_are_a_misfit():
    problem = make_scene(Design(lengths=6), 8).problem
    false = np.array(problem.lengths.lengths)
    false[2] += 0.02
    calibration = calibrate(replace(problem, lengths=replace(problem.lengths, lengths=false)))
    assert "contradict each other" in calibration.message


def test_a_length_whose_spots_are_of_no_one_place_is_left_out():
    problem = make_scene(Design(lengths=5), 9).problem
    spots = problem.lengths.spots.copy()
    along = np.array([0.0, 25.0])
    spots[0, 1, 0] += along
    spots[1, 3] = np.nan
    scale = calibrate(replace(problem, lengths=replace(problem.lengths, spots=spots))).scale
    assert (scale.lengths_used, scale.lengths_given) == (3, 5)
    assert abs(scale.error) < 4.0 * scale.standard_deviation


def test_a_length_with_one_spot_twice_is_left_out():
    problem = make_scene(Design(lengths=5), 9).problem
    spots = problem.lengths.spots.copy()
    spots[:, 2, 1] = spots[:, 2, 0]
    calibration = calibrate(replace(problem, lengths=replace(problem.lengths, spots=spots)))
    assert calibration.success
    assert (calibration.scale.lengths_used, calibration.scale.lengths_given) == (4, 5)
    assert abs(calibration.scale.error) < 4.0 * calibration.scale.standard_deviation < 0.005


def test_one_camera_cannot_measure_a_length():
    calibration = calibrate(make_scene(Design(cameras=1, lengths=4), 10).problem)
    assert calibration.scale is None
    assert calibration.success


def test_no_length_at_all_measures_none():
    problem = make_scene(Design(lengths=4), 10).problem
    known = problem.lengths
    none = replace(
        known,
        lengths=known.lengths[:0],
        standard_deviations=known.standard_deviations[:0],
        spots=known.spots[:, :0],
        spot_covariances=known.spot_covariances[:, :0],
    )
    assert calibrate(replace(problem, lengths=none)).scale is None
