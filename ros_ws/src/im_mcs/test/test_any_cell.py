"""MCS over every shipped cell: any number of arms, joints and names."""

import numpy as np
import pinocchio as pin
import pytest

from im_cell.robot import cell_file, load_cell, shipped_cells
from im_core.errors import ConfigError, ImError
from im_mcs.client.kinematics import Kinematics
from im_mcs.collision import CollisionChecker
from im_mcs.collision.monitor import CollisionMonitor
from im_mcs.control import LawSource
from im_mcs.inverse import Arm, ArmTracker
from im_mcs.limits.configuration import load_config
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel, ControlledModel

OTHERS = [name for name in shipped_cells() if name != "puma_pair"]


@pytest.fixture(scope="module", params=OTHERS)
def name(request):
    return request.param


@pytest.fixture
def any_bench(name, bench_of):
    return bench_of(name)


@pytest.mark.parametrize("each", shipped_cells())
def test_torques_are_those_of_the_urdf_as_pinocchio_reads_it(each):
    """Links that are fixed to others are one body with them; joints of no group stand where the cell says."""
    cell = load_cell(each)
    model, full = CellModel(cell), pin.buildModelFromUrdf(cell.urdf)
    ranks = [full.joints[full.getJointId(joint)].idx_v for joint in model.names]
    random = np.random.default_rng(1)
    for _ in range(20):
        q = random.uniform(cell.per_joint("limits.lower"), cell.per_joint("limits.upper"))
        v, a = random.normal(size=(2, model.n))
        wide = np.zeros((3, full.nv))
        wide[:, ranks] = q, v, a
        theirs = pin.rnea(full, full.createData(), *wide)[ranks]
        np.testing.assert_allclose(model.inverse_dynamics(q, v, a) - model.rotor_inertia * a, theirs, atol=1e-11)
        for group in cell.groups.values():
            pin.framesForwardKinematics(full, data := full.createData(), wide[0])
            np.testing.assert_allclose(model.pose(q, group.tip), data.oMf[full.getFrameId(group.tip)], atol=1e-12)


def test_an_arm_moves_and_comes_to_rest_where_it_was_sent(any_bench):
    groups = any_bench.mcs.groups
    any_bench.to_motion(*groups)
    for group in groups.values():
        target = any_bench.mcs.measured.q[group.index] + 0.15
        reply = any_bench.move(group.name, target)
        assert reply["success"], reply
        np.testing.assert_allclose(any_bench.driver.plant.q[group.index], target, atol=5e-4)


def test_an_emergency_stop_brakes_every_joint(any_bench):
    group = next(iter(any_bench.mcs.groups))
    any_bench.to_motion(group)
    target = any_bench.mcs.measured.q[any_bench.mcs.groups[group].index] + 0.2
    any_bench.send("move", group=group, path={"kind": "joint", "points": [target.tolist()], "blend": 0.0})
    for _ in range(40):
        any_bench.mcs.tick([])
    any_bench.ask("estop", reason="test")
    for _ in range(200):
        any_bench.mcs.tick([])
    assert any_bench.driver.plant.brakes.all()
    assert not any_bench.driver.plant.power
    assert np.abs(any_bench.driver.plant.v).max() < 1e-3


def test_positions_beyond_a_limit_are_refused_by_the_joint_s_name(any_bench):
    group = next(iter(any_bench.mcs.groups))
    any_bench.to_motion(group)
    limits, index = any_bench.mcs.limits, any_bench.mcs.groups[group].index
    target = any_bench.mcs.measured.q[index]
    target[0] = limits.upper[index[0]] + 0.1
    reply = any_bench.move(group, target)
    assert not reply["success"]
    assert limits.names[index[0]] in str(reply)


def test_a_straight_line_is_straight(any_bench):
    """An arm of five joints turns about one axis of its wrist, as it must."""
    bench = any_bench
    group = next(iter(bench.mcs.groups))
    frame = bench.mcs.groups[group].context.frames[0]
    bench.to_motion(group)
    model = bench.mcs.control_model
    start = model.pose(bench.driver.plant.q, frame)
    end = start.translation + np.array([0.0, 0.06, -0.05])
    turns = []

    def note():
        pose = model.pose(bench.driver.plant.q, frame)
        places.append(pose.translation)
        turns.append(pin.log3(start.rotation.T @ pose.rotation))

    pose = [*end, *pin.Quaternion(start.rotation).coeffs()]
    places = []
    reply = bench.ask(
        "move", on_tick=note,
        group=group, path={"kind": "line", "poses": [[float(value) for value in pose]], "speed": 0.05, "blend": 0.0},
    )  # fmt: skip
    assert reply["success"], reply
    way = (end - start.translation) / np.linalg.norm(end - start.translation)
    off = np.array(places) - start.translation
    assert np.linalg.norm(off - np.outer(off @ way, way), axis=1).max() < 1e-3
    np.testing.assert_allclose(places[-1], end, atol=5e-4)
    turned = np.linalg.svd(turns, compute_uv=False) / np.sqrt(len(turns))
    if len(model.joints_below(frame)) > 5:
        assert turned[0] < 1e-3
    else:
        assert turned[0] > 0.05
        assert turned[1] < 1e-3


def test_a_stream_is_followed_and_its_silence_ends_at_rest(any_bench):
    bench, (group, *_) = any_bench, any_bench.mcs.groups.values()
    bench.to_motion(group.name)
    start, ones = bench.mcs.measured.q[group.index].copy(), np.ones(len(group.index))
    turn = 0.01 / bench.driver.period_s
    for k in range(250):
        wanted = start + 0.1 * np.sin(0.01 * k)
        speed = 0.1 * turn * np.cos(0.01 * k) * ones
        bench.send("stream", group=group.name, kind="setpoint", positions=wanted.tolist(), velocities=speed.tolist(),
                   lease_s=0.1)  # fmt: skip
    np.testing.assert_allclose(bench.driver.plant.q[group.index], wanted, atol=1e-2)  # about 30 ms behind
    for _ in range(200):
        bench.mcs.tick([])
    assert np.abs(bench.driver.plant.v).max() < 1e-3
    assert np.abs(bench.driver.plant.q[group.index] - wanted).max() < 0.1
    assert "lease" in [
        each["error"]["code"] for each in bench.events if each["event"] == "reply" and not each["success"]
    ]


def test_derivatives_along_a_line_are_those_of_its_places(name):
    """Central differences of solutions; the wrist turns on the way."""
    model = CellModel(load_cell(name))
    group = next(iter(model.cell.groups.values()))
    arm, start = Arm(model, group.tip), model.cell.home
    tracker, begin = ArmTracker(model, arm, group.tip), model.pose(start, group.tip)
    twist = np.array([0.1, 0.2, -0.1, 0.3, -0.2, 0.2])

    def at(s):
        place = pin.SE3(pin.exp3(s * twist[3:]) @ begin.rotation, begin.translation + s * twist[:3])
        return tracker.solve(place, start)

    h, still = 1e-4, np.zeros(model.n)
    before, here, after = at(0.1 - h), at(0.1), at(0.1 + h)
    found = tracker.derivatives(here, still, still, twist, np.zeros(6))
    np.testing.assert_allclose(found.dq, (after - before) / (2.0 * h), atol=1e-5)
    np.testing.assert_allclose(found.ddq, (after - 2.0 * here + before) / h**2, atol=1e-2)
    v = tracker.velocities(here, twist)
    np.testing.assert_allclose((model.jacobian(here, group.tip) @ v)[:3], twist[:3], atol=1e-9)


def test_a_pose_of_the_tip_has_its_positions(name):
    cell = load_cell(name)
    model, config = CellModel(cell), load_config(cell=cell)
    limits = JointLimits(cell, config.limits, config.slots)
    group = next(iter(config.groups))
    solver = Kinematics(config, model)
    index = solver.index(group)
    random, worst = np.random.default_rng(2), 0.0
    for _ in range(5):
        wanted = cell.home.copy()
        wanted[index] = np.clip(wanted[index] + random.uniform(-0.3, 0.3, len(index)), limits.lower[index] + 0.05,
                                limits.upper[index] - 0.05)  # fmt: skip
        pose = model.pose(wanted, config.groups[group].wrist)
        found = cell.home.copy()
        orientation = pin.Quaternion(pose.rotation).coeffs().tolist()
        found[index] = solver.inverse(group, pose.translation.tolist(), orientation, [], cell.home, False)
        there = model.pose(found, config.groups[group].wrist)
        worst = max(worst, float(np.linalg.norm(pin.log6(pose.actInv(there)).vector)))
        assert ((found >= limits.lower) & (found <= limits.upper)).all()
    assert worst < 1e-6


def test_links_that_meet_are_named(name):
    cell = load_cell(name)
    checker = CollisionChecker(CellModel(cell), 0.01)
    checker.require_free(cell.home)
    random = np.random.default_rng(0)
    for _ in range(2000):
        q = random.uniform(cell.per_joint("limits.lower"), cell.per_joint("limits.upper"))
        if checker.closest(q).distance < 0.0:
            with pytest.raises(ImError, match="would collide with") as told:
                checker.require_free(q)
            bodies = {body.link for body in cell.bodies} | {"floor"}
            assert {told.value.facts["first"], told.value.facts["second"]} <= bodies
            return
    pytest.fail("no position of 2000 has links that meet")


def test_a_law_that_gives_torques_refuses_a_cell_without_masses_or_torques(tmp_path):
    text = cell_file("ur5").with_name("ur5.urdf").read_text().replace('effort="28.0"', 'effort="0"', 1)
    (tmp_path / "ur5.urdf").write_text(text)
    (tmp_path / "cell.yaml").write_text(cell_file("ur5").read_text())
    cell = load_cell(tmp_path / "cell.yaml")
    config, model = load_config(cell=cell), ControlledModel(cell)
    with pytest.raises(ConfigError, match="needs what the cell does not say: joint wrist_1_joint has no limit of eff"):
        LawSource(config, model, cell.per_joint("limits.torque"), 0.0)


def test_a_cell_in_which_nothing_can_meet_is_watched_all_the_same(tmp_path):
    (tmp_path / "ur5.urdf").write_text(cell_file("ur5").with_name("ur5.urdf").read_text())
    text = cell_file("ur5").read_text()
    (tmp_path / "cell.yaml").write_text(text.partition("\ncapsules:")[0])
    cell = load_cell(tmp_path / "cell.yaml")
    model, config = CellModel(cell), load_config(cell=cell)
    assert CollisionChecker(model, 0.01).require_free(cell.home) == np.inf
    limits = JointLimits(cell, config.limits).motion
    monitor = CollisionMonitor(model, limits, config.collision, [np.arange(6)], config.servo.period_s)
    found = monitor.update(cell.home, np.zeros(6), np.zeros(6))
    assert (found.speed_ceiling, found.stop) == (1.0, False)
