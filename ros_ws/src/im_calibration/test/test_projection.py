"""The projection agrees with the camera model, and its derivatives with finite differences."""

import numpy as np
import pytest

from bench.calibration.synthetic import random_rotations
from im_calibration.estimation.projection import image, project
from im_calibration.estimation.unknowns import ParameterLayout, Unknowns, intrinsics_of, rotation_exp, skew
from im_calibration.problem.problem import CalibrationProblem
from im_cell.camera_model import CameraModel
from im_cell.lens import LENSES
from im_cell.workspace import box_around

STEP = 1e-6


@pytest.fixture
def cameras():
    """A camera of each lens model, with any coefficients."""
    rng = np.random.default_rng(4)
    rotations, translations = random_rotations(rng, 3), rng.normal((0.0, 0.0, 4.0), 0.3, (3, 3))
    models = []
    for c, (name, lens) in enumerate(LENSES.items()):
        fx, fy, cx, cy = rng.uniform((400, 400, 200, 200), (800, 800, 400, 400))
        D = lens.all_of(rng.normal(0.0, 0.1, lens.estimated))
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        models.append(CameraModel(640, 480, K, D, rotations[c], translations[c], name))
    still = np.zeros((7, 3))
    lenses = tuple(LENSES.values())
    unknowns = Unknowns(lenses, intrinsics_of(models), rotations, translations, np.zeros(3), np.zeros(0), still)
    return models, unknowns, rng.uniform(-1.0, 1.0, (7, 3))


def test_it_is_the_projection_of_the_camera_model(cameras):
    models, unknowns, points = cameras
    pixels, by_point, _ = project(unknowns, points)
    np.testing.assert_array_equal(image(unknowns, points), pixels)
    for c, model in enumerate(models):
        np.testing.assert_allclose(pixels[c], model.project(points), rtol=1e-12)
        np.testing.assert_allclose(by_point[c], model.project_jacobian(points), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("axis", range(3))
def test_derivatives_by_the_point(cameras, axis):
    _, unknowns, points = cameras
    moved = np.zeros(3)
    moved[axis] = STEP
    numeric = (project(unknowns, points + moved)[0] - project(unknowns, points - moved)[0]) / (2.0 * STEP)
    np.testing.assert_allclose(project(unknowns, points)[1][..., axis], numeric, rtol=1e-5, atol=1e-4)


def test_derivatives_by_the_parameters(cameras):
    _, unknowns, points = cameras
    rows = np.zeros((3, 7, 2))
    problem = CalibrationProblem(
        camera_names=("a", "b", "c"), image_sizes=((640, 480),) * 3, positions=points,
        position_covariances=np.zeros((7, 3, 3)), wrist_rotations=np.tile(np.eye(3), (7, 1, 1)), spots=rows,
        spot_covariances=np.tile(np.eye(2), (3, 7, 1, 1)), workspace=box_around(points), lens_models=tuple(LENSES),
    )  # fmt: skip
    layout, analytic = ParameterLayout.of(problem), project(unknowns, points)[2]
    assert layout.size == 14 + 18 + 14
    for c in range(3):
        for i, place in enumerate(range(*layout.camera_slice(c).indices(layout.size))):
            step = STEP * np.eye(layout.size)[place]
            ahead, back = (image(unknowns.moved(s, layout, np.zeros((7, 3))), points)[c] for s in (step, -step))
            np.testing.assert_allclose(analytic[c][..., i], (ahead - back) / (2.0 * STEP), rtol=1e-5, atol=1e-4)


def test_points_behind_a_camera_have_no_image(cameras):
    _, unknowns, _ = cameras
    behind = np.array([unknowns.rotations[0].T @ (np.array([0.0, 0.0, -1.0]) - unknowns.translations[0])])
    assert np.isnan(project(unknowns, behind)[0][0]).all()


def test_rotation_exp_solves_its_differential_equation():
    vector = np.array([[0.3, -0.5, 0.9]])
    product = np.linalg.matrix_power(np.eye(3) + skew(vector[0]) / 2**20, 2**20)
    np.testing.assert_allclose(rotation_exp(vector)[0], product, atol=2e-6)
    np.testing.assert_array_equal(rotation_exp(np.zeros((1, 3)))[0], np.eye(3))
