import numpy as np
import pinocchio as pin
import pytest

from im_cell.link import Drive, JawObject
from im_cell.robot import load_cell, urdf
from im_sim.plant import Plant

CELL = load_cell()
N = len(CELL.joints)
HELD, FREE = np.ones(N, dtype=bool), np.zeros(N, dtype=bool)
CLOSED = np.zeros(2)
DELAY_TICKS = round(CELL.brakes.delay / CELL.period)
ALL_FORCE = np.full(2, np.inf)
REACHING = np.array([-0.6, 0.4, 0.3, 0.5, 0.6, -1.2, 0.3, 0.6, 0.2, 1.2, -0.3, -0.3, 0.5, 0.8, -1.0, 0.2, 0.5, 0.1])


@pytest.fixture
def plant():
    plant = Plant(CELL, seed=1)
    yield plant
    plant.close()


def command(tau=None, brakes=FREE, power=True, gripper=CLOSED, force=ALL_FORCE):
    return Drive(np.zeros(N) if tau is None else tau, power, brakes, gripper, True, force)


def place(plant, q, v=None):
    plant._world.reset(q, np.zeros(N) if v is None else v)
    plant.q, plant.v = plant._world.state()


def gravity(q):
    model = pin.buildModelFromXML(urdf(CELL))
    return pin.computeGeneralizedGravity(model, model.createData(), q)


@pytest.mark.parametrize("powered", [True, False])
def test_brakes_hold_outstretched_arms_for_ten_seconds(plant, powered):
    place(plant, REACHING)
    for _ in range(round(10.0 / CELL.period)):
        plant.run_tick(command(brakes=HELD, power=powered))
    assert np.abs(plant.q - REACHING).max() < 1e-6


def test_what_stands_without_power_is_stepped_again_once_it_may_move(plant):
    place(plant, REACHING)
    steps = []
    world_step = plant._world.step
    plant._world.step = lambda tau: (steps.append(tau), world_step(tau))[1]
    for _ in range(200):  # the jaws close meanwhile
        plant.run_tick(command(brakes=HELD, power=False))
    stood, steps_before = plant.q.copy(), len(steps)
    for _ in range(50):
        plant.run_tick(command(brakes=HELD, power=False))
    assert len(steps) == steps_before, "nothing moves, and nothing is simulated"
    plant.run_tick(command(brakes=HELD))
    assert len(steps) > steps_before
    for _ in range(DELAY_TICKS + 20):
        plant.run_tick(command())
    assert np.abs(plant.q - stood).max() > 1e-3, "it falls"


def test_what_stands_without_power_feels_what_is_put_between_its_jaws(plant):
    for _ in range(50):
        plant.run_tick(command(brakes=HELD, power=False))
    empty = plant.wrench.copy()
    plant.put((JawObject(width=0.05, stiffness=1e4, mass=1.0), None))
    for _ in range(50):
        plant.run_tick(command(brakes=HELD, power=False))
    gained = np.linalg.norm(plant.wrench[:, :3], axis=1) - np.linalg.norm(empty[:, :3], axis=1)
    assert gained == pytest.approx([CELL.gravity, 0.0], abs=1e-3)


def test_without_brakes_and_torque_the_arm_falls(plant):
    place(plant, REACHING)
    before = pin.computePotentialEnergy
    model = pin.buildModelFromXML(urdf(CELL))
    data = model.createData()
    height = before(model, data, plant.q)
    for _ in range(60):
        plant.run_tick(command())
    assert before(model, data, plant.q) < height - 5.0


def test_gravity_torque_and_dry_friction_hold_the_arm_still(plant):
    place(plant, REACHING)
    tau = gravity(REACHING) + 0.5 * CELL.per_joint("coulomb_positive")
    for _ in range(200):
        plant.run_tick(command(tau))
    assert np.abs(plant.q - REACHING).max() < 1e-12


def test_more_torque_than_friction_moves_and_viscous_friction_bounds_the_speed(plant):
    joint = 0
    tau = gravity(CELL.home)
    tau[joint] = CELL.joints[joint].coulomb_positive + 10.0
    for _ in range(400):
        plant.run_tick(command(tau))
    assert 0.05 < plant.v[joint] < 10.0 / CELL.joints[joint].viscous


def release(plant):
    """Let the brakes go, at home."""
    for _ in range(DELAY_TICKS + 1):
        plant.run_tick(command(gravity(CELL.home)))
    assert not plant.brakes.any()


def test_a_brake_lets_go_and_holds_a_delay_after_its_command(plant):
    tau = gravity(CELL.home)
    for brakes in (FREE, HELD):
        for _ in range(DELAY_TICKS):
            plant.run_tick(command(tau, brakes))
            assert (plant.brakes != brakes).all()
        plant.run_tick(command(tau, brakes))
        assert (plant.brakes == brakes).all()


def test_a_command_that_is_taken_back_begins_its_delay_anew(plant):
    for brakes in (FREE, HELD, FREE):
        for _ in range(DELAY_TICKS):
            plant.run_tick(command(brakes=brakes))
            assert plant.brakes.all()


def test_without_power_the_arm_moves_on_until_the_brakes_hold_and_stops_as_their_torque_says(plant):
    """One joint, whose travel is known: constant speed, then constant deceleration."""
    release(plant)
    v = np.zeros(N)
    v[0] = 0.5
    place(plant, CELL.home, v)
    track = CELL.joints[0]
    model = pin.buildModelFromXML(urdf(CELL))
    mass = pin.crba(model, model.createData(), CELL.home)[0, 0] + track.rotor_inertia
    drag = track.coulomb_positive + 0.5 * track.viscous
    delay_s = DELAY_TICKS * CELL.period
    slower = 0.5 - drag / mass * delay_s
    travel = 0.5 * (0.5 + slower) * delay_s + 0.5 * slower**2 * mass / (track.brake + track.coulomb_positive)
    settled = 0
    for _ in range(200):
        plant.run_tick(None)
        settled += not plant.settling
    assert plant.q[0] - CELL.home[0] == pytest.approx(travel, rel=0.03)
    assert np.abs(plant.v).max() < 1e-9
    assert settled > 0, "time is not wanted any more"


def test_brakes_take_the_energy_of_the_arms_with_the_torque_that_is_stated(plant):
    release(plant)
    place(plant, REACHING, 0.4 * CELL.per_joint("limits.velocity"))
    while not plant.brakes.all():
        plant.run_tick(None)
    model = pin.buildModelFromXML(urdf(CELL))
    data = model.createData()
    inertia = pin.crba(model, data, plant.q)
    inertia = np.triu(inertia) + np.triu(inertia, 1).T + np.diag(CELL.per_joint("rotor_inertia"))
    energy = 0.5 * plant.v @ inertia @ plant.v + pin.computePotentialEnergy(model, data, plant.q)
    way = np.zeros(N)
    while plant.settling:
        before = plant.q
        plant.run_tick(None)
        way += np.abs(plant.q - before)
    taken = energy - pin.computePotentialEnergy(model, data, plant.q)
    brake = CELL.per_joint("brake")
    dry = np.maximum(CELL.per_joint("coulomb_positive"), CELL.per_joint("coulomb_negative"))
    viscous = CELL.per_joint("viscous") * 0.4 * CELL.per_joint("limits.velocity")
    assert brake @ way <= taken * 1.02
    assert taken <= (brake + dry + viscous) @ way * 1.02


def test_brakes_hold_twice_what_any_joint_carries():
    model = pin.buildModelFromXML(urdf(CELL))
    for side in CELL.groups:
        payload = pin.Inertia(2.5, np.array([0.0, 0.0, CELL.gripper.reach]), np.zeros((3, 3)))
        frame = model.frames[model.getFrameId(f"{side}_wrist")]
        model.inertias[frame.parentJoint] += frame.placement.act(payload)
    data, random = model.createData(), np.random.default_rng(0)
    lower, upper = CELL.per_joint("limits.lower"), CELL.per_joint("limits.upper")
    loads = [pin.computeGeneralizedGravity(model, data, random.uniform(lower, upper)) for _ in range(3000)]
    assert (CELL.per_joint("brake") >= 2.0 * np.abs(loads).max(axis=0)).all()


def test_power_off_means_no_torque_and_brakes_whatever_is_commanded(plant):
    before = plant.q
    for _ in range(20):
        plant.run_tick(command(np.full(N, 90.0), brakes=FREE, power=False))
    assert np.abs(plant.q - before).max() < 1e-9
    assert plant.brakes.all()


def test_torques_are_cut_to_the_limits_and_nan_gives_none(plant):
    other = Plant(CELL, seed=1)
    limits = CELL.per_joint("limits.torque")
    wild = np.where(np.arange(N) % 2 == 0, 1e9, np.nan)
    tame = np.where(np.arange(N) % 2 == 0, limits, 0.0)
    for _ in range(10):
        plant.run_tick(command(wild))
        other.run_tick(command(tame))
    assert plant.q.tobytes() == other.q.tobytes()
    assert np.isfinite(plant.q).all()
    other.close()


def test_the_same_seed_and_commands_give_the_same_bits(plant):
    other = Plant(CELL, seed=1)
    third = Plant(CELL, seed=2)
    rng = np.random.default_rng(5)
    for tick in range(60):
        same = command(rng.uniform(-20.0, 20.0, N))
        for each in (plant, other, third):
            each.run_tick(same)
        assert plant.q.tobytes() + plant.v.tobytes() == other.q.tobytes() + other.v.tobytes()
        assert plant.sensors(tick).q.tobytes() == other.sensors(tick).q.tobytes()
        assert plant.sensors(tick).q.tobytes() != third.sensors(tick).q.tobytes()
    other.close()
    third.close()


def test_grippers_travel_at_their_rate_and_stay_without_power(plant):
    ticks = 20
    for _ in range(ticks):
        plant.run_tick(command(brakes=HELD, gripper=np.array([0.0, np.nan])))
    travelled = CELL.gripper.rate * ticks * CELL.period
    assert plant.gripper == pytest.approx([CELL.gripper.initial - travelled, CELL.gripper.initial])
    plant.run_tick(command(brakes=HELD, gripper=np.array([1.0, -1.0])))
    for _ in range(200):
        plant.run_tick(None)
    assert plant.gripper == pytest.approx([CELL.gripper.stroke, 0.0])
