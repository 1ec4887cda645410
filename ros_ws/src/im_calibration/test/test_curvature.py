"""Curvature of the parameters: said where their covariance is no ellipsoid, as of a long lens."""

import pytest

from bench.calibration.lenses import LensDesign, make_lens_scene
from im_calibration.pipeline import calibrate


@pytest.fixture(scope="module")
def answers():
    """The same poses through a usual and a long lens."""
    return {view: calibrate(make_lens_scene(LensDesign(view, poses=15), 100).problem) for view in (60.0, 8.0)}


def test_a_usual_lens_has_an_ellipsoid(answers):
    assert max(camera.curvature for camera in answers[60.0].cameras) < 0.5
    assert "curve" not in answers[60.0].message


def test_a_long_lens_bends_and_the_message_says_so(answers):
    calibration = answers[8.0]
    assert calibration.success
    assert min(camera.curvature for camera in calibration.cameras) > 1.0
    assert "The parameters of camera_0, camera_1 vary together along a curve" in calibration.message
