"""Starts from nothing: exact for pinhole cameras, close enough with outliers, refused where there is no answer."""

from dataclasses import replace

import numpy as np
import pytest

from bench.calibration.synthetic import Design, make_scene
from im_calibration import DegenerateDataError, calibrate
from im_calibration.estimation.start import planar_start, robust_extent, start
from im_calibration.estimation.unknowns import ParameterLayout
from im_cell.camera_model import CameraModel


def pinhole_problem(seed, poses=30):
    scene = make_scene(Design(poses=poses, led_offset_prior_sd=0.0), seed)
    cameras = [replace(camera, D=np.zeros(5)) for camera in scene.cameras]
    spots = np.stack([camera.project(scene.problem.positions) for camera in cameras])
    return replace(scene.problem, spots=spots), cameras


def test_a_pinhole_camera_is_recovered_exactly():
    problem, cameras = pinhole_problem(1)
    found = start(problem, ParameterLayout.of(problem))
    for c, camera in enumerate(cameras):
        expected = [camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]]
        np.testing.assert_allclose(found.intrinsics[c, :4], expected, atol=0.05)
        np.testing.assert_allclose(found.rotations[c], camera.R_cam_base, atol=1e-4)
        np.testing.assert_allclose(found.translations[c], camera.t_cam_base, atol=1e-3)


def test_a_fifth_of_wrong_spots_does_no_harm():
    problem, cameras = pinhole_problem(2)
    spots = problem.spots.copy()
    spots[:, ::5] = np.random.default_rng(0).uniform((0, 0), (640, 480), spots[:, ::5].shape)
    found = start(replace(problem, spots=spots), ParameterLayout.of(problem))
    for c, camera in enumerate(cameras):
        assert found.intrinsics[c, 0] == pytest.approx(camera.K[0, 0], rel=0.03)


def test_the_plane_gives_pose_and_focal_length():
    rng = np.random.default_rng(3)
    K = np.array([[610.0, 0.0, 319.5], [0.0, 610.0, 239.5], [0.0, 0.0, 1.0]])
    angle = 0.5
    tilt = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    camera = CameraModel(640, 480, K, np.zeros(5), tilt @ np.diag([1.0, -1.0, -1.0]), np.array([0.1, 0.0, 3.0]))
    points = np.column_stack((rng.uniform(-0.8, 0.8, (20, 2)), np.full(20, 0.2)))
    found = planar_start(points, camera.project(points), (640, 480), 3.0)
    assert found is not None
    np.testing.assert_allclose(found[0][:2], 610.0, rtol=1e-4)
    np.testing.assert_allclose(found[1], camera.R_cam_base, atol=1e-4)
    np.testing.assert_allclose(found[2], camera.t_cam_base, atol=1e-3)


def test_too_few_spots_are_refused_with_their_number():
    scene = make_scene(Design(poses=6), 4)
    with pytest.raises(DegenerateDataError, match="saw the LED in 6 poses, at least 7") as caught:
        start(scene.problem, ParameterLayout.of(scene.problem))
    assert caught.value.code == "unobservable"
    assert caught.value.facts["camera"] == "camera_0"
    assert "camera_0.intrinsics" in caught.value.parameters


def test_positions_on_a_line_are_refused():
    line = np.linspace((-0.9, -0.4, 0.7), (0.9, 0.4, 1.5), 20)
    scene = make_scene(Design(poses=20, led_offset_prior_sd=0.0), 5, positions=line)
    with pytest.raises(DegenerateDataError, match="on a line"):
        start(scene.problem, ParameterLayout.of(scene.problem))


@pytest.mark.parametrize("reach_m", [1e-160, 1e-9, 1e-4])
def test_positions_in_one_point_up_to_noise_are_refused(reach_m):
    scene = make_scene(Design(poses=20), 0)
    rng = np.random.default_rng(1)
    positions = scene.problem.positions.mean(axis=0) + reach_m * rng.normal(size=(20, 3))
    spots = np.array([camera.project(positions) + 0.1 * rng.normal(size=(20, 2)) for camera in scene.cameras])
    with pytest.raises(DegenerateDataError, match="in all poses at one place of its image, within 1 px"):
        calibrate(replace(scene.problem, positions=positions, spots=spots))
    spread = rng.uniform(0.0, 480.0, size=spots.shape)
    with pytest.raises(DegenerateDataError, match="lie on a line or in a point"):
        calibrate(replace(scene.problem, positions=1e-6 * positions, spots=spread))


def test_extent_ignores_the_farthest_points():
    points = np.random.default_rng(6).normal(0.0, (1.0, 0.5, 0.0), (200, 3))
    points[0] = (0.0, 0.0, 50.0)
    extent = robust_extent(points)
    assert extent[2] < 1e-9
    assert 0.4 < extent[0] < 1.0
