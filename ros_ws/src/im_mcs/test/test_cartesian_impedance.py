"""Cartesian impedance: springs, dampers and a force at the wrist, over the arm's own dynamics without friction."""

import numpy as np
import pinocchio as pin
import pytest

from im_cell.robot import load_cell
from im_core.errors import ConfigError
from im_mcs.control import ControlInput, ControllerSetup, load_controller
from im_mcs.model import CellModel
from im_mcs.planning import Setpoint
from im_mcs.state import State

LAW = "im_mcs.control.cartesian_impedance:CartesianImpedance"
PERIOD_S = 0.0045
GAINS = {
    "translation": 2000.0,
    "rotation": 150.0,
    "damping": 1.0,
    "posture_rad_s": 10.0,
    "derivative_bandwidth_rad_s": 200.0,
}


class Plant:
    """A cell's arms without friction, driven by the law at one group; the other joints stand."""

    def __init__(self, name, joints, **changes):
        self.cell = load_cell(name)
        self.model = CellModel(self.cell)
        self.joints = np.array(joints)
        self.changes = changes
        self.q, self.v = self.cell.home.copy(), np.zeros(self.model.n)
        self.wanted = Setpoint.at_rest(self.cell.home)
        self.law = self.make()

    def make(self, **changes):
        parameters = {**GAINS, **self.changes, **changes}
        limits = np.full(len(self.joints), 1e4)
        return load_controller(
            LAW, ControllerSetup(self.joints, PERIOD_S, self.model, limits, self.cell.home, parameters)
        )

    def torque(self, law=None):
        setpoint = Setpoint(*(row[self.joints] for row in (self.wanted.q, self.wanted.v, self.wanted.a)))
        q, v = self.q[self.joints], self.v[self.joints]
        gravity = self.model.gravity(self.q)[self.joints]
        return (law or self.law).command(ControlInput(q, v, setpoint, gravity, self.q, self.wanted))

    def run(self, seconds, push=(0.0, 0.0, 0.0), wrist=""):
        data, path = self.model.pin.createData(), []
        for _ in range(round(seconds / PERIOD_S)):
            tau = self.model.gravity(self.q)
            tau[self.joints] = self.torque()
            if wrist:
                tau += self.model.jacobian(self.q, wrist)[:3].T @ push
            for _ in range(4):
                a = pin.aba(self.model.pin, data, self.q, self.v, tau)
                a[np.setdiff1d(np.arange(self.model.n), self.joints)] = 0.0
                self.v = self.v + a * PERIOD_S / 4
                self.q = self.q + self.v * PERIOD_S / 4
            path.append(self.model.pose(self.q, wrist or self.wrist).translation)
        return np.array(path)

    @property
    def wrist(self):
        return next(iter(self.cell.groups.values())).tip

    def pose(self):
        return self.model.pose(self.q, self.wrist)


CELLS = [("puma_pair", range(9)), ("ur5", range(6)), ("panda", range(7))]


@pytest.fixture(params=CELLS, ids=[name for name, _ in CELLS])
def plant(request):
    return Plant(*request.param)


def test_a_push_moves_the_wrist_by_force_over_stiffness_and_it_comes_back(plant):
    start, push = plant.pose().translation, np.array([5.0, -6.0, 4.0])
    path = plant.run(1.5, push, plant.wrist)
    np.testing.assert_allclose(path[-1] - start, push / GAINS["translation"], atol=4e-4)
    assert np.max((path - start) @ push) < 1.25 * push @ push / GAINS["translation"], "it is damped"
    back = plant.run(1.5, (0.0, 0.0, 0.0), plant.wrist)
    np.testing.assert_allclose(back[-1], start, atol=4e-4)


def test_a_force_that_is_set_is_what_a_wall_feels(plant):
    """Held by a stiff wall, the wrist presses with the force: the torques are those that carry it."""
    force = [3.0, -5.0, 7.0]
    with_force, without = plant.torque(plant.make(force=force)), plant.torque(plant.make())
    jacobian = plant.model.jacobian(plant.q, plant.wrist)[:3, plant.joints]
    np.testing.assert_allclose(with_force - without, jacobian.T @ force, atol=1e-9)


def test_it_follows_a_motion_and_turns_the_wrist_back(plant):
    last = plant.joints[-1]
    plant.q[last] += 0.05
    plant.run(1.5)
    turned = pin.log3(plant.pose().rotation.T @ plant.model.pose(plant.cell.home, plant.wrist).rotation)
    assert np.linalg.norm(turned) < 2e-3
    assert np.abs(plant.v).max() < 1e-2


def test_a_group_without_a_wrist_is_held_by_its_posture():
    plant = Plant("puma_pair", [0, 1, 2])
    plant.q[:3] += 0.01
    plant.run(3.0)
    np.testing.assert_allclose(plant.q[:3], plant.cell.home[:3], atol=1e-4)


def test_in_the_servo_an_arm_with_friction_moves_presses_and_is_stiff_again(plant_bench, config, cell):
    bench = plant_bench(config, 3)
    bench.to_motion("left")
    before = bench.mcs.groups["left"].controller.name
    assert bench.ask("set_controller", group="left", controller=LAW)["success"]
    target = cell.home[:9] + 0.1
    assert bench.move("left", target)["success"]
    np.testing.assert_allclose(bench.mcs.measured.q[:9], target, atol=2e-2)
    height = bench.mcs.model.pose(bench.mcs.measured.q, "left_wrist").translation[2]
    pushed = {"force": [0.0, 0.0, -60.0]}
    assert bench.ask("set_controller", group="left", controller=LAW, parameters=pushed)["success"]
    lower = bench.mcs.model.pose(bench.mcs.measured.q, "left_wrist").translation[2]
    assert 0.0 < height - lower <= 1.3 * 60.0 / GAINS["translation"]
    assert bench.ask("set_controller", group="left", controller=before)["success"]
    np.testing.assert_allclose(bench.mcs.measured.q[:9], target, atol=1e-3)
    assert bench.mcs.manager.state is State.MOTION


@pytest.mark.parametrize(
    "changes", [{"translation": 0.0}, {"force": [1.0]}, {"force": [0.0, 0.0, float("inf")]}, {"stifness": 1.0}]
)
def test_wrong_parameters_are_named(changes):
    with pytest.raises(ConfigError, match=f"controller '{LAW}': parameter '{next(iter(changes))}"):
        Plant("ur5", range(6), **changes)
