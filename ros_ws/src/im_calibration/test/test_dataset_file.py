"""Data sets that are written are read back as the same problem."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bench.calibration.synthetic import Design, make_scene
from im_calibration.problem.dataset import dataset_of, problems
from im_core.errors import DataError

DESIGN = Design(
    poses=14, missing_share=0.2, heteroscedasticity=3.0, led_offset_prior_sd=0.01, joint_offset_prior_sd=2e-3, lengths=3
)


def test_a_problem_comes_back_from_its_data_set():
    arm = np.random.default_rng(3).normal(size=(DESIGN.poses, 3, 36)) * 1e-3
    written = replace(make_scene(DESIGN, 3).problem, led_offset_nominal=(0.0, 0.06, 0.05), arm_jacobians=arm)
    (read,) = problems(json.loads(json.dumps(dataset_of(written), allow_nan=False)))
    for name in ("camera_names", "pose_names", "image_sizes", "led_offset_prior_sd", "joint_offset_prior_sd"):
        assert getattr(read, name) == getattr(written, name)
    assert (read.led_offset_nominal, read.workspace) == (written.led_offset_nominal, written.workspace)
    for name in ("positions", "position_covariances", "wrist_rotations", "spots", "joint_jacobians", "arm_jacobians"):
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
    np.testing.assert_allclose(read.spot_covariances, written.spot_covariances, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(read.lengths.spots, written.lengths.spots)
    np.testing.assert_allclose(read.lengths.spot_covariances, written.lengths.spot_covariances, rtol=1e-12, atol=1e-15)


def test_whole_covariances_of_spots_images_of_any_size_and_unknown_noise_come_back():
    written = make_scene(replace(DESIGN, anisotropy=3.0), 3).problem
    written = replace(written, image_sizes=((640, 480), (1280, 1024)), noise_to_estimate=("image",))
    content = json.loads(json.dumps(dataset_of(written), allow_nan=False))
    assert "sigma_u_px" not in content
    (read,) = problems(content)
    assert read.image_sizes == written.image_sizes
    assert read.noise_to_estimate == written.noise_to_estimate
    np.testing.assert_array_equal(read.spot_covariances, written.spot_covariances)


def test_noise_that_is_null_is_to_be_estimated():
    content = dataset_of(make_scene(DESIGN, 3).problem)
    (read,) = problems({**content, "sigma_u_px": None, "cov_x_m2": None})
    assert read.noise_to_estimate == ("image", "robot")
    (read,) = problems({**content, "cov_x_m2": None})
    assert read.noise_to_estimate == ("robot",)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sigma_u_p": 1}, r"the data set has the field 'sigma_u_p'.*did you mean 'sigma_u_px'"),
        ({"trials": [{"x_base_m": [], "u_pix": []}]}, r"trials\[0\] has the field 'u_pix'.*did you mean 'u_px'"),
        ({"image_size": [[640, 480], [640, 0]]}, r"image_size\[1\] is 640 x 0, whole numbers"),
        ({"image_size": [[640, 480]]}, r"image_size has 1 elements, 2 are needed"),
        ({"cov_u_px2": [[[[1, 0], [0, 1]]] * 14] * 2}, "cov_u_px2 and sigma_u_px are both given"),
        ({"noise_to_estimate": ["lens"]}, r"noise_to_estimate\[0\] is 'lens', a list of 'image' and 'robot'"),
    ],
)
def test_what_the_format_does_not_have_is_refused(change, message):
    with pytest.raises(DataError, match=message):
        problems({**dataset_of(make_scene(DESIGN, 4).problem), **change})


def test_readings_come_back_and_are_as_many_as_the_poses():
    labels = ("a", "b") * 7
    written = replace(make_scene(DESIGN, 3).problem, readings=labels)
    (read,) = problems(json.loads(json.dumps(dataset_of(written), allow_nan=False)))
    assert read.readings == labels
    assert read.poses_of_readings.tolist() == [list(range(0, 14, 2)), list(range(1, 14, 2))]
    with pytest.raises(DataError, match="reading must be 14 names, got a"):
        problems({**dataset_of(written), "reading": ["a"]})


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
