"""Wrist force-torque sensors against pinocchio, Newton, and the weight of what is held."""

import numpy as np
import pinocchio as pin
import pytest

from im_cell.link import Drive, JawObject
from im_cell.robot import load_cell, urdf
from im_sim.plant import Plant

CELL = load_cell()
N = len(CELL.joints)
HELD, FREE = np.ones(N, dtype=bool), np.zeros(N, dtype=bool)
FULL = np.full(2, np.inf)
MODEL = pin.buildModelFromXML(urdf(CELL))
MODEL.gravity.linear = np.array([0.0, 0.0, -CELL.gravity])
DATA = MODEL.createData()
WRISTS = [MODEL.getFrameId(f"{side}_wrist") for side in CELL.groups]
JOINTS = [MODEL.frames[wrist].parentJoint for wrist in WRISTS]
REACHING = np.array([-0.6, 0.4, 0.3, 0.5, 0.6, -1.2, 0.3, 0.6, 0.2, 1.2, -0.3, -0.3, 0.5, 0.8, -1.0, 0.2, 0.5, 0.1])


@pytest.fixture
def plant():
    plant = Plant(CELL, seed=1)
    yield plant
    plant.close()


def place(plant, q, v=None):
    plant._world.reset(q, np.zeros(N) if v is None else v)
    plant.q, plant.v = plant._world.state()


def command(tau, brakes=FREE, gripper=(0.08, 0.08)):
    return Drive(tau, True, brakes, np.array(gripper), True, FULL)


def wrist_frames(q):
    pin.framesForwardKinematics(MODEL, DATA, q)
    return [DATA.oMf[wrist].copy() for wrist in WRISTS]


def test_at_rest_the_sensors_feel_the_weight_of_link_6(plant):
    place(plant, REACHING)
    plant.run_tick(command(np.zeros(N), HELD))
    for wrench, frame, joint in zip(plant.wrench, wrist_frames(REACHING), JOINTS, strict=True):
        inertia = MODEL.inertias[joint]
        up = frame.rotation.T @ [0.0, 0.0, CELL.gravity * inertia.mass]
        np.testing.assert_allclose(wrench[:3], up, atol=1e-9)
        np.testing.assert_allclose(wrench[3:], np.cross(inertia.lever, up), atol=1e-9)


def test_in_motion_they_feel_what_accelerates_link_6(plant):
    """The rate of change of the link's momentum, from the positions of two steps, is weight plus wrench."""
    rng = np.random.default_rng(3)
    dt = CELL.period / CELL.substeps
    limits = CELL.per_joint("limits.torque")
    for _ in range(20):
        q, v = CELL.home + rng.uniform(-0.2, 0.2, N), rng.normal(0.0, 0.8, N)
        place(plant, q, v)
        plant._substeps = 1
        plant.run_tick(command(0.3 * rng.uniform(-limits, limits)))
        a = (plant.v - v) / dt
        expected = pin.rnea(MODEL, DATA, q, v, a)
        for wrench, wrist, joint in zip(plant.wrench, WRISTS, JOINTS, strict=True):
            assert wrench[5] == pytest.approx(expected[joint - 1], rel=1e-6, abs=1e-9)
            h = 1e-5
            before, after = (_momentum(q - d * v + 0.5 * d * d * a, v - d * a, joint) for d in (h, -h))
            force, torque = np.split((after - before) / (2.0 * h), 2)
            force = force - MODEL.inertias[joint].mass * MODEL.gravity.linear
            pin.framesForwardKinematics(MODEL, DATA, q)
            frame = DATA.oMf[wrist]
            centre = DATA.oMi[joint].act(MODEL.inertias[joint].lever)
            np.testing.assert_allclose(frame.rotation @ wrench[:3], force, rtol=1e-4, atol=1e-4)
            about = torque + np.cross(centre - frame.translation, force)
            np.testing.assert_allclose(frame.rotation @ wrench[3:], about, rtol=1e-4, atol=1e-5)


def _momentum(q, v, joint):
    """Linear momentum, and angular momentum about the centre of mass, of one link in world axes, shape (6,)."""
    pin.forwardKinematics(MODEL, DATA, q, v)
    inertia = MODEL.inertias[joint]
    R = DATA.oMi[joint].rotation
    velocity = DATA.v[joint]
    linear = R @ (velocity.linear + np.cross(velocity.angular, inertia.lever))
    return np.concatenate([inertia.mass * linear, R @ (inertia.inertia @ velocity.angular)])


def test_what_is_held_weighs_on_the_wrist_and_on_the_arm(plant):
    place(plant, REACHING)
    plant.put((JawObject(width=0.04, stiffness=2e4, mass=2.0), None))
    for _ in range(60):
        plant.run_tick(command(np.zeros(N), HELD, gripper=(0.0, 0.08)))
    frame = wrist_frames(REACHING)[0]
    own = MODEL.inertias[JOINTS[0]]
    load = frame.rotation.T @ [0.0, 0.0, CELL.gravity * 2.0]
    own_weight = frame.rotation.T @ [0.0, 0.0, CELL.gravity * own.mass]
    np.testing.assert_allclose(plant.wrench[0, :3], own_weight + load, atol=1e-9)
    torque = np.cross(own.lever, own_weight) + np.cross([0.0, 0.0, CELL.gripper.reach], load)
    np.testing.assert_allclose(plant.wrench[0, 3:], torque, atol=1e-9)

    carried = MODEL.copy()
    at_jaws = pin.SE3(np.eye(3), np.array([0.0, 0.0, CELL.gripper.reach]))
    carried.inertias[JOINTS[0]] += (
        MODEL.frames[WRISTS[0]].placement.act(at_jaws).act(pin.Inertia.FromBox(2.0, 0.04, 0.04, 0.04))
    )
    tau = pin.computeGeneralizedGravity(carried, carried.createData(), REACHING)
    for _ in range(40):
        plant.run_tick(command(tau, gripper=(0.0, 0.08)))
    assert np.abs(plant.q - REACHING).max() < 1e-9, "gravity torque of arm and load holds both"
    for _ in range(40):
        plant.run_tick(command(tau, gripper=(0.08, 0.08)))
    assert np.abs(plant.q - REACHING)[:9].max() > 1e-4, "once it is let go, that torque is too much"


def test_a_wrist_that_presses_on_the_table_feels_it(plant):
    """Left wrist lowered onto the table: the table's push is felt upwards, more the harder the arm presses."""
    q = CELL.home.copy()
    q[7] = 0.0  # so that what is found depends on the seed alone
    rng = np.random.default_rng(0)
    goal = np.array([CELL.boxes[2].center[0] - 0.2, CELL.boxes[2].center[1] - 0.15, 0.75 + 0.22])
    q = _reach(q, goal, rng)
    place(plant, q)
    plant.run_tick(command(np.zeros(N), HELD))
    assert not any(plant._world.contact_wrenches(plant._last_joints)), "at first it hangs above the table"
    gravity = pin.computeGeneralizedGravity(MODEL, DATA, q)
    pin.computeJointJacobians(MODEL, DATA, q)
    J = pin.getFrameJacobian(MODEL, DATA, WRISTS[0], pin.LOCAL_WORLD_ALIGNED).copy()
    carried = []
    for _ in range(60):
        before = wrist_frames(plant.q)[0].translation
        plant.run_tick(command(gravity + J[:3].T @ [0.0, 0.0, -150.0] - 40.0 * plant.v, HELD * (np.arange(N) >= 9)))
        frame = wrist_frames(plant.q)[0]
        still = np.abs(frame.translation - before)[2] < 1e-4
        if plant._world.contact_wrenches(plant._last_joints)[0] and still:
            carried.append((frame.rotation @ plant.wrench[0, :3])[2])
    assert len(carried) > 10, "it lies on the table"
    assert -300.0 < np.median(carried) < -50.0, "the table carries what the arm presses with"


def _reach(q, goal, rng):
    """Joints of the left arm for the wrist at ``goal`` with its z axis down: damped Gauss-Newton from random starts."""
    lower, upper = CELL.per_joint("limits.lower"), CELL.per_joint("limits.upper")
    for _ in range(60):
        q[:9] = np.clip(q[:9] + rng.normal(0.0, 0.5, 9), lower[:9], upper[:9])
        for _ in range(150):
            pin.computeJointJacobians(MODEL, DATA, q)
            pin.updateFramePlacements(MODEL, DATA)
            frame = DATA.oMf[WRISTS[0]]
            tilt = np.cross(frame.rotation[:, 2], [0.0, 0.0, -1.0])
            error = np.concatenate([goal - frame.translation, tilt])
            J = pin.getFrameJacobian(MODEL, DATA, WRISTS[0], pin.LOCAL_WORLD_ALIGNED)[:, :9]
            q[:9] = np.clip(q[:9] + J.T @ np.linalg.solve(J @ J.T + 1e-3 * np.eye(6), error), lower[:9], upper[:9])
        if np.abs(error).max() < 1e-4 and frame.rotation[2, 2] < -0.99:
            return q
    raise AssertionError("no pose above the table")


def test_readings_have_bias_noise_steps_and_an_end_as_specified(plant):
    plant.run_tick(command(np.zeros(N), HELD))
    readings = np.array([plant.sensors(tick).wrench for tick in range(2000)])
    spec = CELL.wrist_sensor
    resolution = np.array([spec.force.resolution] * 3 + [spec.torque.resolution] * 3)
    noise = np.array([spec.force.noise] * 3 + [spec.torque.noise] * 3)
    counts = readings / resolution
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    expected = np.sqrt(noise**2 + resolution**2 / 12.0)
    np.testing.assert_allclose(readings.std(axis=0), [expected, expected], rtol=0.1)
    bias = readings.mean(axis=0) - plant.wrench
    assert (np.abs(bias) < 4.0 * np.array([spec.force.bias] * 3 + [spec.torque.bias] * 3)).all()
    assert np.abs(bias[:, :3]).max() > 0.05
    other = Plant(CELL, seed=1)
    other.run_tick(command(np.zeros(N), HELD))
    assert other.sensors(7).wrench.tobytes() == readings[7].tobytes()
    other.close()
