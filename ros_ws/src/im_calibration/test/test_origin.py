"""Where the origin of the world is makes no difference."""

import numpy as np
import pytest

from bench.calibration.synthetic import Design, make_scene
from im_calibration import calibrate
from im_calibration.estimation.gates import Prediction
from im_cell.workspace import box_around

PROBLEM = make_scene(Design(led_offset_prior_sd=0.02), 32).problem


def assert_same(found, expected, tolerance):
    """Cameras by their standard deviations, covariances by those of both parameters."""
    deviation = expected.standard_deviations
    off = (found.covariance - expected.covariance) / np.outer(deviation, deviation)
    np.testing.assert_allclose(off, 0.0, atol=tolerance)
    for a, b in zip(found.cameras, expected.cameras, strict=True):
        np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-3)
        moved = np.abs(a.model.t_cam_base - b.model.t_cam_base) / b.standard_deviations[-3:]
        np.testing.assert_allclose(moved, 0.0, atol=tolerance)
        np.testing.assert_allclose(a.model.K, b.model.K, rtol=tolerance)
    np.testing.assert_allclose(found.led_positions, expected.led_positions, atol=1e-6)


def test_a_result_is_moved_as_the_problem_is():
    """Estimated there, and estimated here and moved: the derivative of a camera's place by its rotation is right."""
    by = np.array([4.0, -3.0, 2.0])
    assert_same(calibrate(PROBLEM.moved(by)), calibrate(PROBLEM).moved(by), 1e-5)


@pytest.mark.parametrize("far", [100.0, 1000.0, 50_000.0])
def test_a_far_origin_changes_nothing(far):
    by = far * np.array([1.0, -0.7, 0.02])
    here, there = calibrate(PROBLEM), calibrate(PROBLEM.moved(by))
    assert there.verdicts == ()
    assert there.chi2 == pytest.approx(here.chi2, rel=1e-6)
    assert_same(there, here.moved(by), 1e-3)


def test_a_box_around_positions_is_as_large_far_from_the_origin():
    positions = np.random.default_rng(1).uniform(-0.4, 0.4, (200, 3))
    far = np.array([500_123.0, 5_000_456.0, 312.0])
    near, there = box_around(positions), box_around(positions + far)
    np.testing.assert_allclose(np.subtract(there.high, there.low), np.subtract(near.high, near.low), atol=1e-6)


def test_spots_that_do_not_move_with_the_light_are_judged_all_the_same():
    here = Prediction(np.full((1, 2), 3.0), np.eye(2)[None], np.zeros((1, 2, 3)))
    assert here.distance(0, np.array([0]), free=True) == pytest.approx(18.0)
