"""Malformed problems are refused in a sentence that names what is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from bench.calibration.synthetic import Design, make_scene
from im_calibration.problem.problem import KnownLengths
from im_core.errors import DataError

GOOD = make_scene(Design(poses=10), 0).problem


def changed(name, index, value):
    array = np.array(getattr(GOOD, name))
    array[index] = value
    return {name: array}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"camera_names": ()}, "at least one camera"),
        ({"camera_names": ("a", "a")}, "given once, got a, a"),
        ({"image_sizes": ((640, 480),)}, "2 pairs of positive numbers"),
        ({"positions": np.zeros((9, 3))}, r"has shape \(10, 3, 3\), it must be \(9, 3, 3\)"),
        ({"spots": np.zeros((2, 10, 3))}, r"spots has shape \(2, 10, 3\), it must be \(2, 10, 2\)"),
        (changed("positions", (4, 1), np.nan), "positions of pose 4 holds a value that is not finite"),
        (changed("spots", (0, 2, 0), np.nan), "two finite numbers, or two NaN"),
        (changed("wrist_rotations", 3, 2.0 * np.eye(3)), "wrist rotation of pose 3"),
        (changed("wrist_rotations", 3, np.diag([1.0, 1.0, -1.0])), "wrist rotation of pose 3"),
        (changed("position_covariances", 5, -np.eye(3)), "position covariance of pose 5"),
        (changed("spot_covariances", (1, 6), np.zeros((2, 2))), "camera_1 spot covariance of pose 6"),
        ({"led_offset_prior_sd": -1.0}, "led_offset_prior_sd is -1, it must be 0, which is exact, or within 1e-09"),
        ({"led_offset_prior_sd": np.nan}, "led_offset_prior_sd is nan, it must be 0"),
        ({"led_offset_prior_sd": 1e-300}, "led_offset_prior_sd is 1e-300, it must be 0"),
        ({"joint_offset_prior_sd": 1e300}, r"joint_offset_prior_sd is 1e\+300, it must be 0"),
        (changed("positions", (4, 1), -1e160), r"A value of positions is 1e\+160 m, it must be at most 1e\+07"),
        (changed("spots", (0, 3), 1e160), r"A value of spots is 1e\+160 px, it must be at most 1e\+06"),
        ({"joint_jacobians": np.full((10, 3, 6), 1e160)}, r"A value of joint_jacobians is 1e\+160 m/rad, it must be"),
        (changed("position_covariances", 5, 1e30 * np.eye(3)), r"pose 5 has a standard deviation of 1e\+15, it must"),
        (changed("spot_covariances", (1, 6), 1e-300 * np.eye(2)), "pose 6 has a standard deviation of 1e-150, it must"),
        ({"joint_offset_prior_sd": 0.01}, "needs joint_jacobians"),
        ({"pose_names": ("a", "b")}, "2 pose names for 10 poses"),
    ],
)
def test_malformed_problems_are_refused(change, sentence):
    detected = GOOD.detected
    assert detected[0, 2]
    assert detected[1, 6]
    with pytest.raises(DataError, match=sentence):
        replace(GOOD, **change)


def test_malformed_lengths_are_refused():
    good = KnownLengths(np.ones(2), np.zeros(2), np.ones((1, 2, 2, 2)), np.tile(np.eye(2), (1, 2, 2, 1, 1)))
    for change, sentence in (
        ({"lengths": np.array([1.0, np.nan])}, "> 0 and at most 1000 m"),
        ({"lengths": np.array([1e300, 1.0])}, "> 0 and at most 1000 m"),
        ({"standard_deviations": np.array([0.0, np.inf])}, ">= 0 and at most 1000 m"),
        ({"spots": 1e30 * good.spots}, r"spot of a known length must be within 1e\+06 px"),
        ({"spot_covariances": np.nan * good.spot_covariances}, "known length 0 of camera 0 is not a covariance matrix"),
        ({"spot_covariances": 1e-40 * good.spot_covariances}, "of camera 0 has a standard deviation of 1e-20"),
    ):
        with pytest.raises(DataError, match=sentence):
            replace(good, **change)


def test_arrays_cannot_be_changed_afterwards():
    with pytest.raises(ValueError, match="read-only"):
        GOOD.positions[0, 0] = 1.0


def test_poses_are_numbered_when_they_have_no_names():
    assert GOOD.pose_names == tuple(str(i) for i in range(10))
