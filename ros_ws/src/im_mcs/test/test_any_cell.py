"""MCS over every shipped cell, and over robots of no cell: any number of arms, any number and kind of joints."""

import numpy as np
import pinocchio as pin
import pytest
import yaml

from im_cell.robot import cell_file, load_cell, shipped_cells
from im_core.config import package_file
from im_core.errors import ConfigError, ImError
from im_mcs.cell.template import first_cell
from im_mcs.client.kinematics import Kinematics
from im_mcs.collision import Bodies, CollisionChecker, lever_bounds
from im_mcs.collision.monitor import CollisionMonitor
from im_mcs.control import LawSource
from im_mcs.inverse import Arm, ArmTracker
from im_mcs.limits.configuration import load_config
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel, ControlledModel

OTHERS = [name for name in shipped_cells() if name != "puma_pair"]
X, Y, Z = "1 0 0", "0 1 0", "0 0 1"
#: Robots of no shipped cell, as ``im cell new`` takes each from a URDF: type, axis, place in the link before [m], and
#: range of each joint; the last place is the tool's.
ROBOTS = {
    "scara": [("revolute", Z, "0 0 0.4", 2.2), ("revolute", Z, "0.3 0 0.1", 2.4),
              ("prismatic", "0 0 -1", "0.26 0 0", 0.15), ("revolute", "0 0 -1", "0 0 -0.12", 3.1), "0 0 -0.03"],
    "gantry": [("prismatic", X, "0 0 1.2", 0.6), ("prismatic", Y, "0 0 -0.1", 0.5),
               ("prismatic", Z, "0.12 0 0", 0.3), "0 0 -0.3"],
    "palletizer": [("revolute", Z, "0 0 0.6", 1.4), ("revolute", Y, "0.3 0 0.2", 1.4), ("revolute", Y, "0 0 1.7", 2.4),
                   ("revolute", Y, "0 0 1.3", 1.4), "0 0 0.4"],
    "gantry_wrist": [("prismatic", X, "0 0 1.2", 0.6), ("prismatic", Y, "0 0 -0.1", 0.5),
                     ("prismatic", Z, "0.12 0 0", 0.3), ("continuous", Z, "0 0 -0.33", None),
                     ("revolute", Y, "0 0 -0.05", 1.5), "0 0 -0.1"],
    "rail_arm": [("prismatic", X, "0 0 0.12", 1.2), ("revolute", Z, "0 0 0.22", 2.9),
                 ("revolute", Y, "0 0.11 0.1", 1.9), ("revolute", Y, "0 -0.1 0.4", 2.4),
                 ("revolute", Z, "0 0 0.4", 3.0), ("revolute", Y, "0 0 0.11", 1.8),
                 ("revolute", Z, "0 0 0.09", 3.0), "0 0 0.02"],
    "stanford": [("revolute", Z, "0 0 0.4", 2.9), ("revolute", Y, "0 0.15 0", 1.5), ("prismatic", Z, "0 0 0.3", 0.9),
                 ("revolute", Z, "0 0 0.2", 2.9), ("revolute", Y, "0 0 0.05", 1.5), ("revolute", Z, "0 0 0.05", 2.9),
                 "0 0 0.08"],
    "snake": [("prismatic", X, "0 0 0.2", 0.4),
              *(("revolute", axis, "0 0 0.25", 2.0) for axis in (Z, Y, Y, Z, Y, Z, Y, Z)), "0 0 0.1"],
    "continuous": [("continuous", axis, "0 0 0.15", None) for axis in (Z, Y, Z, Y, Z, Y, Z)] + ["0 0 0.1"],
}  # fmt: skip

TURNTABLE = f"""<robot name="r"><link name="base"/><link name="plate">
<inertial><mass value="4"/><inertia ixx="0.05" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.1"/></inertial>
<collision><geometry><cylinder radius="0.2" length="0.04"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="plate"/><origin xyz="0.5 0 0.3"/><axis xyz="{Z}"/>
<limit lower="-3" upper="3" velocity="1" effort="80"/></joint></robot>
"""


def robot_urdf(robot):
    """Return a URDF of a chain; each link is a rod half as long as the way to the next joint."""
    *moving, tool = ROBOTS[robot]
    joints = [*moving, ("fixed", Z, tool, None)]
    names = [*(f"link_{k}" for k in range(len(joints))), "tool"]
    reaches = [max(abs(sum(map(float, joint[2].split()))) / 2.0, 0.03) for joint in joints[1:]]
    inertia = (
        '<inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>'
    )
    lines = [f'<link name="{names[0]}"/>', '<link name="tool"/>']
    for link, reach in zip(names[1:-1], reaches, strict=True):
        rod = f'<geometry><box size="0.03 0.03 {reach:.3f}"/></geometry>'
        lines.append(f'<link name="{link}">{inertia}<collision>{rod}</collision></link>')
    for (kind, axis, place, end), parent, child in zip(joints, names, names[1:], strict=False):
        limit = "" if end is None else f'lower="{-end}" upper="{end}"'
        moves = f'<axis xyz="{axis}"/><limit {limit} velocity="1" effort="100"/>'
        ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{place}"/>'
        lines.append(f'<joint name="to_{child}" type="{kind}">{ends}{moves}</joint>')
    return "\n".join(['<robot name="r">', *lines, "</robot>"])


@pytest.fixture(scope="module", params=[*OTHERS, *ROBOTS])
def name(request, tmp_path_factory):
    """Name of a shipped cell, or the first cell file of a robot."""
    if request.param in shipped_cells():
        return request.param
    folder = tmp_path_factory.mktemp(request.param)
    (folder / "robot.urdf").write_text(robot_urdf(request.param))
    (folder / "cell.yaml").write_text(first_cell(folder / "robot.urdf"))
    return folder / "cell.yaml"


def beside(mcs, index, way):
    """Return positions some way from those measured, shape (n,), to the side with room in the range."""
    q, lower, upper = mcs.measured.q[index], mcs.limits.lower[index], mcs.limits.upper[index]
    way = np.minimum(way, 0.4 * (upper - lower))
    return np.where(q + way < upper - 0.02, q + way, q - way)


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
        target = beside(any_bench.mcs, group.index, 0.15)
        reply = any_bench.move(group.name, target)
        assert reply["success"], reply
        np.testing.assert_allclose(any_bench.driver.plant.q[group.index], target, atol=5e-4)


def test_an_emergency_stop_brakes_every_joint(any_bench):
    group = next(iter(any_bench.mcs.groups))
    any_bench.to_motion(group)
    target = beside(any_bench.mcs, any_bench.mcs.groups[group].index, 0.2)
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


def test_a_straight_line_is_straight(name, any_bench):
    """Of fewer joints than six each that is missing is a turn of the wrist that the arm gives up, and no other."""
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
    assert (turned[max(6 - len(model.joints_below(frame)), 0) :] < 1e-3).all()
    assert name != "so101" or turned[0] > 0.05


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

    def place_at(s):
        return pin.SE3(pin.exp3(s * twist[3:]) @ begin.rotation, begin.translation + s * twist[:3])

    def at(s):
        return tracker.solve(place_at(s), start)

    h, still = 1e-4, np.zeros(model.n)
    before, here, after = at(0.1 - h), at(0.1), at(0.1 + h)
    found = tracker.derivatives(here, still, still, place_at(0.1), twist, np.zeros(6))
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


@pytest.mark.parametrize("name", [*shipped_cells(), *ROBOTS], indirect=True)
def test_no_distance_changes_faster_than_its_bound(name):
    """The bound is of the size of the arm."""
    bodies = Bodies(model := CellModel(load_cell(name)))
    levers = lever_bounds(model, bodies)
    lower, upper = model.cell.per_joint("limits.lower"), model.cell.per_joint("limits.upper")
    random = np.random.default_rng(4)
    tightest = np.zeros(model.n)
    for _ in range(40):
        a = lower + random.uniform(size=model.n) * (upper - lower)
        b = a + random.normal(size=model.n) * 0.02 * (random.uniform(size=model.n) < 0.3)
        bodies.place(a)
        before = np.array([bodies.distance(k) for k in range(len(bodies.pairs))])
        bodies.place(b)
        after = np.array([bodies.distance(k) for k in range(len(bodies.pairs))])
        apart = (before > 0.0) & (after > 0.0)
        bound = levers @ np.abs(b - a)
        assert (np.abs(after - before) <= bound + 5e-6)[apart].all()
        tightest = np.maximum(tightest, np.abs(b - a))
    assert (tightest > 0.0).all()
    assert levers.max() < 4.0


@pytest.mark.parametrize("each", OTHERS)
def test_links_that_meet_are_named(each):
    cell = load_cell(each)
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


@pytest.mark.parametrize(("old", "new", "sentence"), [
    ('effort="28.0"', 'effort="0"', "needs what the cell does not say: joint wrist_1_joint has no limit of effort"),
    ('effort="150.0"', 'effort="9"', "joint shoulder_lift_joint gives up to 9, and needs .* to hold the arm at home"),
])  # fmt: skip
def test_torques_unknown_or_too_small_are_refused_by_laws_that_give_torques_alone(tmp_path, old, new, sentence):
    text = cell_file("ur5").with_name("ur5.urdf").read_text()
    (tmp_path / "ur5.urdf").write_text(text.replace(old, new))
    (tmp_path / "cell.yaml").write_text(cell_file("ur5").read_text())
    cell = load_cell(tmp_path / "cell.yaml")
    model, torque = ControlledModel(cell), cell.per_joint("limits.torque")
    with pytest.raises(ConfigError, match=sentence):
        LawSource(load_config(cell=cell), model, torque, 0.0)
    data = yaml.safe_load(package_file("im_mcs", "config/mcs.yaml").read_text())
    data["control"] = {"controller": "im_mcs.control.setpoints:SetpointPosition"}
    settings = {"joints": list(cell.joint_names), "state_topic": "/s", "command_topic": "/c", "period_s": 0.0045}
    driver = {"driver": "im_mcs.testbed.joint_state:CommandTopicDriver", "settings": settings}
    data["testbed"] = {"clock": "robot", "drivers": {"robot": driver}}
    data["slots"] = [
        {"name": name, "driver": "robot", "channel": channel, "interface": "position"}
        for channel, name in enumerate(cell.joint_names)
    ]
    (tmp_path / "mcs.yaml").write_text(yaml.safe_dump(data))
    LawSource(load_config(tmp_path / "mcs.yaml", cell), model, torque, 0.0).close()


def test_one_joint_is_an_arm_too(tmp_path, bench_of):
    (tmp_path / "robot.urdf").write_text(TURNTABLE)
    (tmp_path / "cell.yaml").write_text("urdf: robot.urdf\ngroups: {table: {tip: plate, home: [0.2]}}\n")
    bench = bench_of(tmp_path / "cell.yaml")
    bench.to_motion("table")
    assert bench.move("table", np.array([0.7]))["success"]
    np.testing.assert_allclose(bench.driver.plant.q, [0.7], atol=5e-4)
    model, config = CellModel(load_cell(tmp_path / "cell.yaml")), bench.mcs.config
    pose = model.pose(np.array([-0.4]), "plate")
    turn = pin.Quaternion(pose.rotation).coeffs().tolist()
    solver = Kinematics(config, model)
    found = solver.inverse("table", pose.translation.tolist(), turn, [], model.cell.home, False)
    np.testing.assert_allclose(found, [-0.4], atol=1e-6)
    assert solver.forward("table", [0.1], model.cell.home).jacobian.shape == (6, 1)
    line = {"kind": "line", "poses": [[*pose.translation, *turn]], "speed": 0.05, "blend": 0.0}
    reply = bench.ask("move", group="table", path=line)
    assert "joints that carry plate: 1; an arm needs 3 or more" in str(reply)


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
