"""The camera model against OpenCV-like references, finite differences and its own inverse."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from im_cell.camera_model import PARAMETERS, CameraModel
from im_cell.lens import LENSES
from im_core.errors import DataError

K = np.array([[605.0, 0.0, 324.0], [0.0, 598.0, 236.5], [0.0, 0.0, 1.0]])
D = np.array([-0.22, 0.04, 7e-4, -5e-4, 0.01])
R = Rotation.from_euler("xyz", [170.0, 12.0, -7.0], degrees=True).as_matrix()
CAMERA = CameraModel(640, 480, K, D, R, -R @ np.array([0.9, -0.35, 4.2]))
points = st.tuples(st.floats(-1.0, 1.0), st.floats(-0.5, 0.5), st.floats(0.6, 1.6)).map(np.array)


def test_projection_by_hand():
    x_cam = R @ np.array([0.2, -0.1, 1.0]) + CAMERA.t_cam_base
    x, y = x_cam[:2] / x_cam[2]
    r2 = x**2 + y**2
    radial = 1 + D[0] * r2 + D[1] * r2**2 + D[4] * r2**3
    expected = (
        605.0 * (x * radial + 2 * D[2] * x * y + D[3] * (r2 + 2 * x * x)) + 324.0,
        598.0 * (y * radial + D[2] * (r2 + 2 * y * y) + 2 * D[3] * x * y) + 236.5,
    )
    np.testing.assert_allclose(CAMERA.project([0.2, -0.1, 1.0]), expected, rtol=1e-12)


@given(points)
@settings(max_examples=50, deadline=None)
def test_jacobian_by_finite_differences(point):
    step = 1e-6
    numeric = np.stack(
        [(CAMERA.project(point + e) - CAMERA.project(point - e)) / (2 * step) for e in step * np.eye(3)], axis=-1
    )
    np.testing.assert_allclose(CAMERA.project_jacobian(point), numeric, atol=2e-5)


@given(points)
@settings(max_examples=50, deadline=None)
def test_ray_goes_through_the_point(point):
    ray = CAMERA.ray(CAMERA.project(point))
    towards = point - CAMERA.position
    np.testing.assert_allclose(ray, towards / np.linalg.norm(towards), atol=1e-10)


def test_arrays_of_points_as_one_by_one():
    some = np.random.default_rng(0).uniform([-1, -0.5, 0.6], [1, 0.5, 1.6], (3, 4, 3))
    np.testing.assert_allclose(CAMERA.project(some)[1, 2], CAMERA.project(some[1, 2]))
    np.testing.assert_allclose(CAMERA.project_jacobian(some)[2, 3], CAMERA.project_jacobian(some[2, 3]))
    np.testing.assert_allclose(CAMERA.ray(CAMERA.project(some))[0, 1], CAMERA.ray(CAMERA.project(some[0, 1])))


@pytest.mark.parametrize("model", list(LENSES))
def test_derivative_by_each_parameter(model):
    """Against images in cameras that are a little other ones."""
    points = np.random.default_rng(1).uniform([-1, -0.5, 0.6], [1, 0.5, 1.6], (5, 3))
    lens, h = LENSES[model], 1e-6
    D = 0.1 * np.cos(np.arange(len(lens.coefficients)))
    original = replace(CAMERA, D=D, distortion_model=model)
    places = [PARAMETERS.index(name) for name in lens.coefficients]

    def seen(step):
        changed = CAMERA.K.copy()
        changed[[0, 1, 0, 1], [0, 1, 2, 2]] += step[:4]
        turned = Rotation.from_rotvec(step[-6:-3]).as_matrix() @ CAMERA.R_cam_base
        shifted = CAMERA.t_cam_base + step[-3:]
        return replace(original, K=changed, D=D + step[places], R_cam_base=turned, t_cam_base=shifted).project(points)

    numeric = np.stack([(seen(step) - seen(-step)) / (2.0 * h) for step in h * np.eye(len(PARAMETERS))], axis=-1)
    np.testing.assert_allclose(original.project_by_parameters(points), numeric, rtol=1e-5, atol=1e-5)


def test_behind_the_camera_is_nowhere():
    uv = CAMERA.project([[0.0, 0.0, 9.0], [0.0, 0.0, 1.0]])
    assert np.isnan(uv[0]).all()
    assert CAMERA.contains(uv).tolist() == [False, True]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K": np.eye(2)}, r"K of a camera has shape \(2, 2\), it must be \(3, 3\)"),
        ({"D": [0.0] * 4}, "D of a camera has shape"),
        ({"t_cam_base": [np.nan, 0, 0]}, "t_cam_base of a camera holds a value that is not finite"),
        ({"R_cam_base": np.diag([1.0, 1.0, -1.0])}, "not a rotation"),
        ({"K": np.diag([-1.0, 1.0, 1.0])}, "focal lengths"),
        ({"width": 0}, "0 x 480 px"),
    ],
)
def test_nonsense_is_refused(change, message):
    fields = {"width": 640, "height": 480, "K": K, "D": D, **change}
    with pytest.raises(DataError, match=message):
        CameraModel(**fields)


def test_lens_that_cannot_be_inverted_is_refused():
    camera = CameraModel(640, 480, K, np.array([-2.0, 0.0, 0.0, 0.0, 0.0]))
    with pytest.raises(DataError, match="cannot be inverted"):
        camera.undistort([639.0, 479.0])
