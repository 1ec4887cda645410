"""The projection agrees with the camera model, and its derivatives with finite differences."""

import numpy as np
import pytest

from bench.calibration.synthetic import random_rotations
from im_calibration.estimation.projection import image, project
from im_calibration.estimation.unknowns import rotation_exp, skew
from im_cell.camera_model import CameraModel

STEP = 1e-6


@pytest.fixture
def cameras():
    rng = np.random.default_rng(4)
    intrinsics = np.column_stack(
        (rng.uniform(400, 800, (3, 2)), rng.uniform(200, 400, (3, 2)), rng.normal(0.0, (0.2, 0.1, 0.01, 0.01), (3, 4)))
    )
    rotations = random_rotations(rng, 3)
    return intrinsics, rotations, rng.normal((0.0, 0.0, 4.0), 0.3, (3, 3)), rng.uniform(-1.0, 1.0, (7, 3))


def test_it_is_the_projection_of_the_camera_model(cameras):
    intrinsics, rotations, translations, points = cameras
    pixels, by_point, _ = project(intrinsics, rotations, translations, points)
    np.testing.assert_array_equal(image(intrinsics, rotations, translations, points), pixels)
    for c, (fx, fy, cx, cy, *lens) in enumerate(intrinsics):
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        model = CameraModel(640, 480, K, np.array([*lens, 0.0]), rotations[c], translations[c])
        np.testing.assert_allclose(pixels[c], model.project(points), rtol=1e-12)
        np.testing.assert_allclose(by_point[c], model.project_jacobian(points), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("axis", range(3))
def test_derivatives_by_the_point(cameras, axis):
    *camera, points = cameras
    moved = np.zeros(3)
    moved[axis] = STEP
    numeric = (project(*camera, points + moved)[0] - project(*camera, points - moved)[0]) / (2.0 * STEP)
    np.testing.assert_allclose(project(*camera, points)[1][..., axis], numeric, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("parameter", range(14))
def test_derivatives_by_the_parameters(cameras, parameter):
    intrinsics, rotations, translations, points = cameras

    def at(step):
        vector = np.zeros(14)
        vector[parameter] = step
        turned = rotation_exp(np.tile(vector[8:11], (3, 1))) @ rotations
        return project(intrinsics + vector[:8], turned, translations + vector[11:], points)[0]

    numeric = (at(STEP) - at(-STEP)) / (2.0 * STEP)
    analytic = project(intrinsics, rotations, translations, points)[2][..., parameter]
    np.testing.assert_allclose(analytic, numeric, rtol=1e-5, atol=1e-4)


def test_points_behind_a_camera_have_no_image(cameras):
    intrinsics, rotations, translations, _ = cameras
    behind = np.array([rotations[0].T @ (np.array([0.0, 0.0, -1.0]) - translations[0])])
    assert np.isnan(project(intrinsics[:1], rotations[:1], translations[:1], behind)[0]).all()


def test_rotation_exp_solves_its_differential_equation():
    vector = np.array([[0.3, -0.5, 0.9]])
    product = np.linalg.matrix_power(np.eye(3) + skew(vector[0]) / 2**20, 2**20)
    np.testing.assert_allclose(rotation_exp(vector)[0], product, atol=2e-6)
    np.testing.assert_array_equal(rotation_exp(np.zeros((1, 3)))[0], np.eye(3))
