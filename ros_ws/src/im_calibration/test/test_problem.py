"""Malformed problems are refused in a sentence that names what is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from bench.calibration.synthetic import Design, make_scene
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
        ({"led_offset_prior_sd": -1.0}, "led_offset_prior_sd is -1.0, it must be a finite number >= 0"),
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


def test_arrays_cannot_be_changed_afterwards():
    with pytest.raises(ValueError, match="read-only"):
        GOOD.positions[0, 0] = 1.0


def test_poses_are_numbered_when_they_have_no_names():
    assert GOOD.pose_names == tuple(str(i) for i in range(10))
