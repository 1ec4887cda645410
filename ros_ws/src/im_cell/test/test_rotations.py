"""Rotations by quaternions, vectors and angles against those of SciPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from im_cell.rotations import (
    cross_matrix,
    matrix_of_quaternion,
    matrix_of_rpy,
    matrix_of_vector,
    quaternion_of_matrix,
    rpy_of_matrix,
)
from im_core.errors import DataError

RANDOM = np.random.default_rng(4).normal(size=(200, 3))
HALF_TURNS = np.pi * np.vstack([np.eye(3), np.sqrt(0.5) * (1.0 - np.eye(3))])
#: Any turn, small ones, none, half ones about axes and between them.
VECTORS = np.vstack([RANDOM, 1e-9 * np.eye(3), np.zeros((1, 3)), HALF_TURNS])


def test_rotations_are_those_of_scipy():
    expected = Rotation.from_rotvec(VECTORS)
    matrices = expected.as_matrix()
    np.testing.assert_allclose([matrix_of_vector(vector) for vector in VECTORS], matrices, atol=1e-14)
    np.testing.assert_allclose(matrix_of_quaternion(1.0005 * expected.as_quat()), matrices, atol=1e-14)
    np.testing.assert_allclose(matrix_of_quaternion(expected[0].as_quat()), matrices[0], atol=1e-14)
    for rpy in RANDOM:
        np.testing.assert_allclose(matrix_of_rpy(rpy), Rotation.from_euler("xyz", rpy).as_matrix(), atol=1e-14)
    for rotation, expected_quaternion in zip(matrices, expected.as_quat(), strict=True):
        found = np.array(quaternion_of_matrix(rotation))
        assert found[np.abs(found).argmax()] > 0.0
        np.testing.assert_allclose(found * np.sign(found @ expected_quaternion), expected_quaternion, atol=1e-14)


def test_the_matrix_of_a_cross_product():
    first, second = RANDOM[:100], RANDOM[100:]
    np.testing.assert_allclose((cross_matrix(first) @ second[..., None])[..., 0], np.cross(first, second), atol=1e-14)


@pytest.mark.parametrize("wrong", [[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 2.0], [0.0, 0.0, 0.0, np.nan]])
def test_a_quaternion_of_another_length_is_refused(wrong):
    with pytest.raises(DataError, match=rf"^it has length {np.linalg.norm(wrong):.4g}, it must be 1$"):
        matrix_of_quaternion([[0.0, 0.0, 0.0, 1.0], wrong], "it")


def test_roll_pitch_and_yaw_lead_back_to_the_rotation():
    angles = [
        *np.random.default_rng(2).uniform(-np.pi, np.pi, size=(50, 3)),
        [0.4, np.pi / 2, 0.3],
        [-2, -np.pi / 2, 1],
    ]
    for given in angles:
        rotation = Rotation.from_euler("xyz", given).as_matrix()
        found = rpy_of_matrix(rotation)
        assert abs(found[1]) <= np.pi / 2
        np.testing.assert_allclose(Rotation.from_euler("xyz", found).as_matrix(), rotation, atol=1e-9)
