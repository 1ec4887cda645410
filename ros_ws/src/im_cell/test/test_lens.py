"""Lens models against OpenCV, finite differences and their own inverses."""

import cv2
import numpy as np
import pytest

from im_cell.calibration_files.intrinsics import camera_info_yaml, read_intrinsics
from im_cell.camera_model import CameraModel
from im_cell.lens import LENSES, lens_of
from im_core.errors import DataError

COEFFICIENTS = {
    "plumb_bob": [-0.28, 0.11, 1e-3, -7e-4, -0.02],
    "rational_polynomial": [0.4, -0.03, 6e-4, -9e-4, 0.004, 0.75, 0.04, -0.002],
    "equidistant": [-0.02, 0.006, -0.004, 0.0009],
}
K = np.array([[420.0, 0.0, 641.0], [0.0, 418.0, 512.5], [0.0, 0.0, 1.0]])
FOCAL = (420.0, 418.0)


def ideal(widest, count=60):
    rng = np.random.default_rng(3)
    angle, turn = rng.uniform(0.0, widest, count), rng.uniform(-np.pi, np.pi, count)
    points = np.tan(angle)[:, None] * np.stack((np.cos(turn), np.sin(turn)), axis=-1)
    return np.vstack((points, [[0.0, 0.0], [1e-9, 0.0]]))


WIDEST = {"plumb_bob": 0.6, "rational_polynomial": 0.9, "equidistant": 1.4}


@pytest.fixture(params=list(LENSES))
def lens(request):
    return LENSES[request.param]


def test_images_are_those_of_opencv(lens):
    points, D = ideal(WIDEST[lens.name]), np.array(COEFFICIENTS[lens.name])
    model = CameraModel(1280, 1024, K, D, distortion_model=lens.name)
    rays = np.column_stack((points, np.ones(len(points))))
    project = cv2.fisheye.projectPoints if lens.name == "equidistant" else cv2.projectPoints
    args = (np.zeros(3), np.zeros(3), K, D)
    expected = project(rays[:, None], *args)[0].reshape(-1, 2)
    np.testing.assert_allclose(model.project(3.0 * rays), expected, atol=1e-7)


def test_derivatives_by_finite_differences(lens):
    points, D = ideal(WIDEST[lens.name]), np.array(COEFFICIENTS[lens.name])
    step = 1e-6
    by_point = [(lens.distort(points + e, D) - lens.distort(points - e, D)) / (2 * step) for e in step * np.eye(2)]
    np.testing.assert_allclose(lens.jacobian(points, D), np.stack(by_point, axis=-1), rtol=1e-5, atol=1e-7)
    steps = step * np.eye(len(D))
    by_coefficient = [(lens.distort(points, D + e) - lens.distort(points, D - e)) / (2 * step) * FOCAL for e in steps]
    found = lens.by_coefficients(points, D, FOCAL)
    np.testing.assert_allclose(found, np.stack(by_coefficient, axis=-1), rtol=1e-5, atol=1e-4)


def test_undistorted_points_are_the_ideal_ones(lens):
    points, D = ideal(WIDEST[lens.name]), np.array(COEFFICIENTS[lens.name])
    np.testing.assert_allclose(lens.undistort(lens.distort(points, D), D), points, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "D"), [("equidistant", [-0.3, 0, 0, 0]), ("rational_polynomial", [0] * 5 + [-0.9, 0, 0])]
)
def test_what_no_ideal_point_is_imaged_to_is_refused(name, D):
    with pytest.raises(DataError, match=f"{name}, D = .* cannot be inverted"):
        lens_of(name).undistort([[-9.0, 0.1]], D)


def test_files_of_cameras_keep_the_model(lens, tmp_path):
    camera = CameraModel(1280, 1024, K, np.array(COEFFICIENTS[lens.name]), distortion_model=lens.name)
    (tmp_path / "wall.yaml").write_text(camera_info_yaml("wall", camera))
    found = read_intrinsics(tmp_path / "wall.yaml").model
    assert found.distortion_model == lens.name
    np.testing.assert_array_equal(found.D, camera.D)


def test_unknown_models_and_wrong_numbers_of_coefficients_are_refused():
    with pytest.raises(DataError, match="'omni' is unknown, it must be one of plumb_bob, rational_polynomial, equidis"):
        CameraModel(640, 480, K, np.zeros(4), distortion_model="omni")
    with pytest.raises(DataError, match="plumb_bob has 4 or 5 coefficients, got 3"):
        lens_of("plumb_bob").all_of([0.1, 0.2, 0.3])
    with pytest.raises(DataError, match=r"D of a camera has shape \(5,\), it must be \(8,\)"):
        CameraModel(640, 480, K, np.zeros(5), distortion_model="rational_polynomial")
