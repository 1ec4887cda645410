"""The model against independent references: a product of DH matrices, and finite differences."""

import json
from math import cos, pi, sin

import numpy as np
import pytest

from im_core.errors import NotFoundError

# P.I. Corke and B. Armstrong-Helouvry, ICRA 1994: d, a, alpha of the PUMA 560, standard DH
PUMA_560 = (
    (0.67183, 0.0, pi / 2),
    (0.0, 0.4318, 0.0),
    (0.15005, 0.0203, -pi / 2),
    (0.4318, 0.0, pi / 2),
    (0.0, 0.0, -pi / 2),
    (0.0, 0.0, 0.0),
)


def dh(q):
    T = np.eye(4)
    for theta, (d, a, alpha) in zip(q, PUMA_560, strict=True):
        c, s, ca, sa = cos(theta), sin(theta), cos(alpha), sin(alpha)
        T = T @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
    return T


@pytest.fixture
def positions(model, cell):
    random = np.random.default_rng(3)
    lower, upper = cell.per_joint("limits.lower"), cell.per_joint("limits.upper")
    return [lower + random.uniform(size=18) * (upper - lower) for _ in range(5)]


def test_arm_is_the_product_of_dh_matrices(model, positions):
    for q in positions:
        base, wrist = model.pose(q, "left_base"), model.pose(q, "left_wrist")
        np.testing.assert_allclose(base.actInv(wrist).homogeneous, dh(q[3:9]), atol=1e-12)


def test_gravity_is_the_gradient_of_potential_energy(model, cell, positions):
    import pinocchio as pin

    data = model.pin.createData()
    for q in positions:
        numeric = np.zeros(18)
        for i in range(18):
            step = np.zeros(18)
            step[i] = 1e-6
            up = pin.computePotentialEnergy(model.pin, data, q + step)
            numeric[i] = (up - pin.computePotentialEnergy(model.pin, data, q - step)) / 2e-6
        np.testing.assert_allclose(model.gravity(q), numeric, atol=1e-6)


def test_jacobian_is_the_derivative_of_the_pose(model, positions):
    for q in positions:
        jacobian = model.jacobian(q, "left_wrist")
        for i in range(9):
            step = np.zeros(18)
            step[i] = 1e-6
            numeric = (
                model.pose(q + step, "left_wrist").translation - model.pose(q - step, "left_wrist").translation
            ) / 2e-6
            np.testing.assert_allclose(jacobian[:3, i], numeric, atol=1e-8)
        assert not jacobian[:, 9:].any()


def test_rotors_are_in_the_inertia(model, cell):
    inertia = model.inertia(cell.home)
    np.testing.assert_allclose(inertia, inertia.T)
    rotors = cell.per_joint("rotor_inertia")
    assert np.linalg.eigvalsh(inertia - np.diag(rotors)).min() > 0
    np.testing.assert_allclose(rotors[3:9], [0.784, 2.325, 0.577, 0.191, 0.171, 0.194], atol=1e-3)
    zero = np.zeros(18)
    np.testing.assert_allclose(model.inverse_dynamics(cell.home, zero, zero), model.gravity(cell.home), atol=1e-9)


def test_unknown_names_are_refused(model, cell):
    with pytest.raises(NotFoundError, match="did you mean 'left_wrist'"):
        model.pose(cell.home, "left_wris")
    with pytest.raises(NotFoundError, match="left_j7"):
        model.index("left_j7")
    assert json.dumps(model.names)
