"""Data sets that are written are read back as the same problem."""

import json

import numpy as np
import pytest

from bench.calibration.synthetic import Design, make_scene
from im_calibration.problem.dataset import dataset_of, problems
from im_core.errors import DataError

DESIGN = Design(
    poses=14, missing_share=0.2, heteroscedasticity=3.0, led_offset_prior_sd=0.01, joint_offset_prior_sd=2e-3, lengths=3
)


def test_a_problem_comes_back_from_its_data_set():
    written = make_scene(DESIGN, 3).problem
    (read,) = problems(json.loads(json.dumps(dataset_of(written), allow_nan=False)))
    for name in ("camera_names", "pose_names", "image_sizes", "led_offset_prior_sd", "joint_offset_prior_sd"):
        assert getattr(read, name) == getattr(written, name)
    for name in ("positions", "position_covariances", "wrist_rotations", "spots", "joint_jacobians"):
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
    np.testing.assert_allclose(read.spot_covariances, written.spot_covariances, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(read.lengths.spots, written.lengths.spots)
    np.testing.assert_allclose(read.lengths.spot_covariances, written.lengths.spot_covariances, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"camera_names": ["a", "a"]}, "camera_names must be 2 different names, got a, a"),
        ({"pose_names": ["a"]}, "pose_names must be 14 different names"),
        ({"camera_names": "ab"}, "camera_names must be a list of names"),
    ],
)
def test_names_must_be_as_many_as_there_are_and_differ(change, message):
    with pytest.raises(DataError, match=message):
        problems({**dataset_of(make_scene(DESIGN, 4).problem), **change})
