"""The model against recursive Newton-Euler by standard Denavit-Hartenberg, in numpy alone, and against a textbook.

J.Y.S. Luh, M.W. Walker, R.P.C. Paul, "On-line computational scheme for mechanical manipulators", J. Dyn. Sys. Meas.
Control 102 (1980); parameters: P.I. Corke, B. Armstrong-Helouvry, ICRA 1994, typed in again here.
"""

import json
from dataclasses import dataclass, replace
from math import cos, pi, sin

import numpy as np
import pytest

from im_mcs.model.command import main

READY = [0.0, pi / 4, pi, 0.0, pi / 4, 0.0]
AXIS = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Row:
    d: float
    a: float
    alpha: float
    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float]
    motor_inertia: float
    gear: float

    def transform(self, theta):
        c, s, ca, sa = cos(theta), sin(theta), cos(self.alpha), sin(self.alpha)
        rotation = np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0.0, sa, ca]])
        return rotation, np.array([self.a * c, self.a * s, self.d])


PUMA_560 = (
    Row(0.67183, 0.0, pi / 2, 0.0, (0.0, 0.0, 0.0), (0.0, 0.35, 0.0), 200e-6, -62.6111),
    Row(0.0, 0.4318, 0.0, 17.4, (-0.3638, 0.006, 0.2275), (0.13, 0.524, 0.539), 200e-6, 107.815),
    Row(0.15005, 0.0203, -pi / 2, 4.8, (-0.0203, -0.0141, 0.07), (0.066, 0.086, 0.0125), 200e-6, -53.7063),
    Row(0.4318, 0.0, pi / 2, 0.82, (0.0, 0.019, 0.0), (1.8e-3, 1.3e-3, 1.8e-3), 33e-6, 76.0364),
    Row(0.0, 0.0, -pi / 2, 0.34, (0.0, 0.0, 0.0), (0.3e-3, 0.4e-3, 0.3e-3), 33e-6, 71.923),
    Row(0.0, 0.0, 0.0, 0.09, (0.0, 0.0, 0.032), (0.15e-3, 0.15e-3, 0.04e-3), 33e-6, 76.686),
)
# K.S. Fu, R.C. Gonzalez, C.S.G. Lee, "Robotics" (1987), table 2.1
PUMA_600 = (
    *PUMA_560[:2],
    replace(PUMA_560[2], d=0.14909, a=0.02032),
    replace(PUMA_560[3], d=0.43307),
    *PUMA_560[4:],
)


def forward_kinematics(rows, q):
    T = np.eye(4)
    for row, theta in zip(rows, q, strict=True):
        A = np.eye(4)
        A[:3, :3], A[:3, 3] = row.transform(theta)
        T = T @ A
    return T


def inverse_dynamics(rows, q, v, a, gravity=9.81):
    """Torques without motors, shape (6,) [Nm]."""
    rotations = [row.transform(theta)[0] for row, theta in zip(rows, q, strict=True)]
    along = [np.array([row.a, row.d * sin(row.alpha), row.d * cos(row.alpha)]) for row in rows]
    w, wd, acc = np.zeros(3), np.zeros(3), np.array([0.0, 0.0, gravity])
    forces, moments = [], []
    for row, R, p, qd, qdd in zip(rows, rotations, along, v, a, strict=True):
        wd = R.T @ (wd + AXIS * qdd + np.cross(w, AXIS * qd))
        w = R.T @ (w + AXIS * qd)
        acc = R.T @ acc + np.cross(wd, p) + np.cross(w, np.cross(w, p))
        com, inertia = np.array(row.com), np.diag(row.inertia)
        forces.append(row.mass * (acc + np.cross(wd, com) + np.cross(w, np.cross(w, com))))
        moments.append(inertia @ wd + np.cross(w, inertia @ w))
    f, n, R_next = np.zeros(3), np.zeros(3), np.eye(3)
    tau = np.zeros(len(rows))
    for i in reversed(range(len(rows))):
        row, p = rows[i], along[i]
        n = R_next @ (n + np.cross(R_next.T @ p, f)) + np.cross(p + np.array(row.com), forces[i]) + moments[i]
        f = R_next @ f + forces[i]
        tau[i] = n @ (rotations[i].T @ AXIS)
        R_next = rotations[i]
    return tau


def inertia(rows, q):
    """Joint-space inertia without motors, shape (6, 6) [kg m2]."""
    zero = np.zeros(6)
    return np.column_stack([inverse_dynamics(rows, q, zero, unit, gravity=0.0) for unit in np.eye(6)])


def motors(rows):
    """Inertia of the rotors at the joints, shape (6, 6) [kg m2]."""
    return np.diag([row.motor_inertia * row.gear**2 for row in rows])


@pytest.mark.parametrize(("group", "rows"), [("left_arm", PUMA_560), ("right_arm", PUMA_600)], ids=["560", "600"])
def test_arms_are_those_of_the_recursion(capsys, group, rows):
    random = np.random.default_rng(7)
    for q in random.uniform(-3.0, 3.0, (5, 6)):
        assert main(["--group", group, "--q", json.dumps(q.tolist()), "--json"]) == 0
        out = capsys.readouterr().out
        assert out.count("\n") == 1
        said = json.loads(out)
        zero = np.zeros(6)
        expected = {
            "forward_kinematics": forward_kinematics(rows, q),
            "gravity_torques": inverse_dynamics(rows, q, zero, zero),
            "inertia": inertia(rows, q),
            "inertia_with_motor": inertia(rows, q) + motors(rows),
        }
        for key, value in expected.items():
            np.testing.assert_allclose(said[key], value, rtol=0.0, atol=1e-10, err_msg=key)


def test_velocity_torques_are_those_of_the_recursion(model):
    random = np.random.default_rng(8)
    for _ in range(20):
        q, v, a = np.zeros(18), np.zeros(18), np.zeros(18)
        q[3:9], v[3:9], a[3:9] = random.uniform(-3.0, 3.0, (3, 6))
        expected = inverse_dynamics(PUMA_560, q[3:9], v[3:9], a[3:9])
        expected += motors(PUMA_560) @ a[3:9]
        np.testing.assert_allclose(model.inverse_dynamics(q, v, a)[3:9], expected, rtol=0.0, atol=1e-10)


def test_the_numbers_of_the_textbook(capsys):
    """P.I. Corke, "Robotics, Vision and Control" (2011), 9.2: gravload and inertia of p560 at qn, printed so."""
    main(["--q", json.dumps(READY), "--json"])
    said = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(said["gravity_torques"], [0.0, 31.6399, 6.0351, 0.0, 0.0283, 0.0], atol=6e-5)
    textbook = [
        [3.6594, -0.4044, 0.1006, -0.0025, 0.0, 0.0],
        [-0.4044, 4.4137, 0.3509, 0.0, 0.0024, 0.0],
        [0.1006, 0.3509, 0.9378, 0.0, 0.0015, 0.0],
        [-0.0025, 0.0, 0.0, 0.1925, 0.0, 0.0],
        [0.0, 0.0024, 0.0015, 0.0, 0.1713, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.1941],
    ]
    np.testing.assert_allclose(said["inertia_with_motor"], textbook, atol=6e-5)
    np.testing.assert_allclose(np.array(said["forward_kinematics"])[:3, 3], [0.5963, -0.15005, 0.6575], atol=6e-5)
