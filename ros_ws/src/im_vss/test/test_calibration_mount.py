"""Cameras that are calibrated where an arm holds them."""

import numpy as np
from scipy.spatial.transform import Rotation

from im_cell.camera_model import CameraModel
from im_vss.services.svc_calibrate import fixed_to


def test_a_camera_on_an_arm_sees_the_same_from_its_mount():
    turned, mount = Rotation.random(2, random_state=3)
    K = np.array([[600.0, 0.0, 320.0], [0.0, 601.0, 240.0], [0.0, 0.0, 1.0]])
    camera = CameraModel(
        640, 480, K, np.array([-0.2, 0.05, 1e-3, -1e-3, 0.0]), turned.as_matrix(), np.array([0.1, -0.4, 2.0])
    )
    origin = np.array([0.7, -0.2, 1.1])
    in_mount = np.random.default_rng(4).uniform(-0.5, 0.5, (50, 3)) + 0.3
    in_world = mount.apply(in_mount) + origin
    ahead = camera.to_camera(in_world)[:, 2] > 0.1
    assert ahead.sum() > 10
    seen = fixed_to(camera, mount.as_matrix(), origin).project(in_mount[ahead])
    np.testing.assert_allclose(seen, camera.project(in_world[ahead]), atol=1e-9)
