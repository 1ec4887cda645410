"""pybullet against pinocchio, which never saw pybullet's idea of the cell."""

import numpy as np
import pinocchio as pin
import pytest

from im_cell.robot import load_cell, urdf
from im_sim.actuators import Actuators
from im_sim.dynamics import Dynamics
from im_sim.world import World

CELL = load_cell()
DT = CELL.period / CELL.substeps
MODEL = pin.buildModelFromXML(urdf(CELL))
DATA = MODEL.createData()
LOWER, UPPER = CELL.per_joint("limits.lower"), CELL.per_joint("limits.upper")
N = len(CELL.joints)
FREE = np.zeros(N, dtype=bool)


def without_friction(cell):
    """The same cell with motors that turn freely."""
    free = {"viscous": 0.0, "coulomb": (0.0, 0.0)}
    drives = {
        name: drive.model_copy(update={"motor": drive.motor.model_copy(update=free)})
        for name, drive in cell.drives.items()
    }
    return type(cell).model_validate(cell.model_copy(update={"drives": drives}).model_dump())


@pytest.fixture
def world():
    world = World(CELL, DT)
    yield world
    world.close()


def test_inverse_dynamics_agree(world):
    rng = np.random.default_rng(0)
    for _ in range(100):
        q, v, a = rng.uniform(LOWER, UPPER), rng.normal(0.0, 2.0, N), rng.normal(0.0, 5.0, N)
        ours = pin.rnea(MODEL, DATA, q, v, a)
        np.testing.assert_allclose(world.inverse_dynamics(q, v, a), ours, rtol=0.0, atol=1e-9)


def test_a_free_step_is_that_of_the_arm_with_its_rotors(world):
    """One step from random states: the acceleration is pinocchio's ABA with armature."""
    smooth = without_friction(CELL)
    assert not smooth.per_joint("coulomb_positive").any()
    model = pin.buildModelFromXML(urdf(CELL))
    model.armature = CELL.per_joint("rotor_inertia")
    data = model.createData()
    limits = CELL.per_joint("limits.torque")
    rng = np.random.default_rng(1)
    for _ in range(50):
        q, v = rng.uniform(0.5 * LOWER, 0.5 * UPPER), rng.normal(0.0, 1.0, N)
        q[[0, 9]] = CELL.home[[0, 9]]
        q[4], q[13] = 1.6, 1.6  # upper arms up, clear of the floor
        tau = rng.uniform(-limits, limits)
        actuators = Actuators(smooth, Dynamics(smooth), DT)
        actuators.command(tau, True, FREE)
        world.reset(q, v)
        world.step(actuators.applied(q, v))
        acceleration = (world.state()[1] - v) / DT
        expected = pin.aba(model, data, q, v, tau)
        np.testing.assert_allclose(acceleration, expected, rtol=1e-7, atol=1e-7)


def test_energy_is_kept_in_free_motion(world):
    """Without torque and friction, kinetic (rotors included) plus potential energy stays, to the integrator's order."""
    smooth = without_friction(CELL)
    rotors = CELL.per_joint("rotor_inertia")
    actuators = Actuators(smooth, Dynamics(smooth), DT)
    actuators.command(np.zeros(N), True, FREE)

    def energy(q, v):
        kinetic = pin.computeKineticEnergy(MODEL, DATA, q, v) + 0.5 * float(v @ (rotors * v))
        return kinetic + pin.computePotentialEnergy(MODEL, DATA, q), kinetic

    v = np.zeros(N)
    v[[0, 3, 5, 9]] = 0.3, 0.8, 0.5, -0.1
    world.reset(CELL.home, v)
    start, _ = energy(CELL.home, v)
    moved = 0.0
    for _ in range(150):
        q, v = world.state()
        world.step(actuators.applied(q, v))
        total, kinetic = energy(*world.state())
        moved = max(moved, kinetic)
        assert total == pytest.approx(start, abs=0.02 * moved)
