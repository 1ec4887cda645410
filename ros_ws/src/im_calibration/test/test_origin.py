"""Where the origin of the world is makes no difference."""

import numpy as np
import pytest

from bench.calibration.synthetic import Design, make_scene
from im_calibration import calibrate

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
