"""The compiled actuators against numpy and pinocchio: the law of the step, and the torque that brings it about."""

import numpy as np
import pinocchio as pin
import pytest

from im_cell.link import JawObject
from im_cell.robot import load_cell
from im_cell.robot.arm_errors import gear_waves
from im_sim.actuators import Actuators, DryFriction
from im_sim.dynamics import Dynamics
from im_sim.readings import Readings

CELL = load_cell()
N, DT = len(CELL.joints), CELL.period / CELL.substeps
OPEN = np.zeros(N, dtype=np.bool_)


@pytest.mark.parametrize("braked", [0, 9, N])
@pytest.mark.parametrize("speed", [0.0, 1e-3, 1.0])
@pytest.mark.parametrize("mass", [0.0, 1.5])
def test_the_torque_is_that_of_the_motion_under_friction(braked, speed, mass):
    rng = np.random.default_rng(braked)
    dynamics = Dynamics(CELL)
    actuators = Actuators(CELL, dynamics, DT)
    if mass:
        dynamics.carry((JawObject(0.06, 1e4, mass), None))
    brakes = OPEN.copy()
    brakes[:braked] = True
    q, v = CELL.home, speed * rng.normal(size=N) * ~brakes
    viscous = CELL.per_joint("viscous")
    armature = CELL.per_joint("rotor_inertia") + DT * viscous
    for _ in range(4):  # the state of friction in one step is where the next one begins
        torque = 0.5 * rng.uniform(-1.0, 1.0, N) * CELL.per_joint("limits.torque")
        actuators.command(torque, True, brakes)
        actuators.prepare(q, v)
        applied = actuators.applied(q, v)
        bare, data = dynamics.bare, dynamics.bare.createData()
        bias, mass_matrix = pin.nonLinearEffects(bare, data, q, v), pin.crba(bare, data, q)
        rotors = np.diag(bare.armature)
        a = np.linalg.solve(mass_matrix - rotors, applied - bias)  # as pybullet moves, without rotors
        load, of_load = dynamics.model, dynamics.model.createData()
        felt = pin.crba(load, of_load, q).dot(a) + pin.nonLinearEffects(load, of_load, q, v) + viscous * v - torque
        held = np.where(brakes, CELL.per_joint("brake"), 0.0)
        forwards, backwards = CELL.per_joint("coulomb_positive") + held, CELL.per_joint("coulomb_negative") + held
        after, close = v + DT * a, 1e-6 * (1.0 + np.abs(torque).max())
        moves = np.abs(after) > 1e-9
        assert (felt <= backwards + close).all()
        assert (felt >= -forwards - close).all()
        np.testing.assert_allclose(felt[moves & (after > 0)], -forwards[moves & (after > 0)], atol=close)
        np.testing.assert_allclose(felt[moves & (after < 0)], backwards[moves & (after < 0)], atol=close)
        assert actuators.stuck == (not moves.any())
        np.testing.assert_allclose(bare.armature, armature)
        v = after * moves


def test_torques_are_cut_and_what_is_no_number_gives_none():
    most, torques = CELL.per_joint("limits.torque"), []
    for given, power in (
        (np.full(N, np.nan), True),
        (np.zeros(N), True),
        (most, False),
        (9 * most, True),
        (most, True),
    ):
        actuators = Actuators(CELL, Dynamics(CELL), DT)
        actuators.command(given, power, OPEN)
        torques.append(actuators.applied(CELL.home, np.ones(N)))
    np.testing.assert_array_equal(torques[:2], [torques[1], torques[2]])
    np.testing.assert_array_equal(torques[3], torques[4])
    assert (torques[3] != torques[2]).all()


def test_arrays_of_another_size_are_refused():
    friction = DryFriction(3)
    with pytest.raises(ValueError, match="2 numbers, not 3"):
        friction.slips_on(np.zeros(2))
    with pytest.raises(TypeError, match="no array of floats"):
        friction.bound([1.0, 1.0, 1.0], np.zeros(3))
    with pytest.raises(ValueError, match="not as many"):
        Readings(np.zeros((1, 4)), np.ones(8), np.ones(9), 1)
    with pytest.raises(ValueError, match="2 numbers, not 6 in a row"):
        Readings(np.zeros((1, 4)), np.ones(8), np.ones(8), 1).told(np.zeros(1), np.zeros(2), np.zeros(1), np.zeros(8))


def test_readings_are_those_of_numpy_to_the_bit():
    rng = np.random.default_rng(1)
    joints, wrists, jaws = 5, 3, 2
    n = joints + 6 * wrists + jaws
    q, wrench, force = rng.normal(size=joints), rng.normal(size=(wrists, 6)), rng.normal(size=jaws)
    noise, gear = rng.normal(size=n), 1e-2 * rng.normal(size=(joints, 4))
    resolution, most = 10.0 ** rng.uniform(-6, -1, n), rng.uniform(0.1, 2.0, n)
    wrench[1, 2] = np.nan
    true = np.concatenate((q - (gear * gear_waves(q)).sum(axis=1), wrench.ravel(), force))
    expected = np.clip(np.rint((true + noise) / resolution) * resolution, -most, most)
    told = Readings(gear, resolution, most, wrists).told(q, wrench, force, noise)
    assert [part.shape for part in told] == [q.shape, wrench.shape, force.shape]
    np.testing.assert_array_equal(np.concatenate([part.ravel() for part in told]), expected)
