"""The compiled joint input and output against pybullet's own functions, to the bit."""

import numpy as np
import pybullet
import pytest

from im_cell.robot import load_cell
from im_sim.world import World
from im_sim.world_joints import WorldJoints

CELL = load_cell()
N, DT = len(CELL.joints), CELL.period / CELL.substeps


@pytest.fixture
def worlds():
    made = [World(CELL, DT) for _ in range(2)]
    yield made
    for world in made:
        world.close()


def of_pybullet(world):
    states = pybullet.getJointStates(world.body, world._joints, world.client)
    return [np.array([state[k] for state in states]) for k in (0, 1)]


def test_steps_states_and_contacts_are_those_of_pybullet(worlds):
    own, other = worlds
    rng, touched = np.random.default_rng(1), set()
    for _ in range(1200):
        tau = 0.02 * CELL.per_joint("limits.torque") * rng.normal(size=N)
        found = own.step(tau)
        pybullet.setJointMotorControlArray(
            other.body, other._joints, pybullet.TORQUE_CONTROL, forces=tau.tolist(), physicsClientId=other.client
        )
        pybullet.stepSimulation(other.client)
        np.testing.assert_array_equal(found, of_pybullet(other))
        np.testing.assert_array_equal(own.state(), of_pybullet(own))
        touch = WorldJoints(own.client, own.body, own._joints).touch()
        assert touch == bool(pybullet.getContactPoints(own.body, physicsClientId=own.client))
        touched.add(touch)
    assert touched == {False, True}, "the arms fall onto the table in the end"


def test_what_cannot_be_is_refused(worlds):
    world, _ = worlds
    with pytest.raises(ValueError, match="2 torques are given for 18 joints"):
        world.step(np.zeros(2))
    with pytest.raises(pybullet.error):
        WorldJoints(999, world.body, world._joints)
