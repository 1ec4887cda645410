import numpy as np
import pinocchio as pin
import pytest

from im_core.errors import ImError, LimitError, StateError
from im_mcs.limits.limits import JointLimits
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.line.line import LinePreparation
from im_mcs.planning.planner import GroupPlanner
from im_mcs.planning.trajectories.trajectory import Setpoint
from im_mcs.protocol.requests import LineMove

PERIOD = 0.0045
SIX, NINE = np.arange(3, 9), np.arange(9)


class Lines:
    """Prepares lines of the left wrist from a place where the arm is well bent."""

    def __init__(self, config, model, cell):
        self.config, self.model = config, model
        self.limits = JointLimits(model.cell, config.limits)
        self.start = cell.home.copy()
        self.start[7] = 0.8
        self.pose = model.pose(self.start, "left_wrist")

    def target(self, step, turn=(0.0, 0.0, 0.0)):
        rotation = self.pose.rotation @ pin.exp3(np.array(turn))
        return [*(self.pose.translation + step), *pin.Quaternion(rotation).coeffs()]

    def prepare(self, index, poses, speed=0.25, blend=0.0, frames=("left_wrist",), start=None):
        q = self.start if start is None else start
        context = PlanContext(self.model, self.limits, index, frames, lambda: q, 2 * PERIOD, self.config)
        preparation = LinePreparation(
            context, LineMove(poses=poses, speed=speed, blend=blend), lambda: Setpoint.at_rest(q[index])
        )
        for _ in range(2000):
            trajectory = preparation.step()
            if trajectory is not None:
                return trajectory
        raise AssertionError("the preparation does not end")

    def ticks(self, trajectory):
        return trajectory.span(np.arange(int(trajectory.duration / PERIOD) + 2) * PERIOD)

    def poses(self, index, q):
        whole = self.start.copy()
        for row in q:
            whole[index] = row
            yield self.model.pose(whole, "left_wrist")


@pytest.fixture(scope="module")
def lines(config, model, cell):
    return Lines(config, model, cell)


def off_line(pose, start, end):
    """Distance of a pose from the straight line in SE(3), in position [m] and rotation [rad]."""
    way = end.translation - start.translation
    turn = pin.log3(end.rotation @ start.rotation.T)
    lead = np.linalg.norm(turn) > np.linalg.norm(way)
    if lead:
        share = pin.log3(pose.rotation @ start.rotation.T) @ turn / (turn @ turn)
    else:
        share = (pose.translation - start.translation) @ way / (way @ way)
    rotation = pin.exp3(turn * share) @ start.rotation
    off = pose.translation - start.translation - share * way
    return np.linalg.norm(off), np.linalg.norm(pin.log3(pose.rotation @ rotation.T)), share


CASES = [
    (SIX, [0.0, 0.4, 0.0], (0.0, 0.0, 0.0)),
    (SIX, [0.0, -0.4, 0.0], (0.2, 0.0, 0.3)),
    (SIX, [0.2, 0.2, -0.28], (0.0, 0.0, 0.0)),
    (SIX, [0.4, 0.0, 0.0], (0.0, 0.0, 0.0)),
    (NINE, [0.4, 0.0, 0.0], (0.0, 0.0, 0.0)),
    (NINE, [-0.4, 0.0, 0.0], (0.0, 0.4, 0.0)),
    (NINE, [0.0, 0.0, -0.4], (0.0, 0.0, 0.0)),
    (SIX, [0.0, 0.0, 0.0], (0.3, 0.2, 0.5)),
    (NINE, [0.0, 0.0, 0.0], (-0.3, 0.2, 0.5)),
]


@pytest.mark.parametrize(("index", "step", "turn"), CASES)
def test_the_wrist_stays_on_its_line_within_all_limits(lines, index, step, turn):
    target = lines.target(step, turn)
    trajectory = lines.prepare(index, [target])
    s, limits = lines.ticks(trajectory), lines.limits.motion.of(index)
    end = pin.SE3(pin.Quaternion(np.array(target[3:])).matrix(), np.array(target[:3]))
    offs = np.array([off_line(pose, lines.pose, end) for pose in lines.poses(index, s.q)])
    assert offs[:, 0].max() < 5e-5
    assert offs[:, 1].max() < 1e-4
    assert (np.diff(offs[:, 2]) > -1e-6).all()
    assert offs[-1, 2] == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(s.q[0], lines.start[index], atol=1e-9)
    for row in (s.v[0], s.a[0], s.v[-1], s.a[-1]):
        np.testing.assert_allclose(row, 0.0, atol=1e-9)
    assert (np.abs(s.v) <= limits.velocity).all()
    assert (np.abs(s.a) <= limits.acceleration).all()
    assert (np.abs(np.diff(s.a, axis=0)) / PERIOD <= limits.jerk * 1.001).all()
    # velocities and accelerations are those of the positions
    np.testing.assert_allclose(np.diff(s.q, axis=0) / PERIOD, (s.v[1:] + s.v[:-1]) / 2.0, atol=5e-4)
    change = np.diff(s.v, axis=0) / PERIOD - (s.a[1:] + s.a[:-1]) / 2.0
    assert (np.abs(change) <= limits.jerk * PERIOD / 4.0).all()
    assert (s.q >= lines.limits.lower[index]).all()
    assert (s.q <= lines.limits.upper[index]).all()


@pytest.mark.parametrize("index", [SIX, NINE])
def test_the_tool_keeps_its_speed(lines, index):
    s = lines.ticks(lines.prepare(index, [lines.target([0.0, 0.4, 0.0])], speed=0.25))
    place = np.array([pose.translation for pose in lines.poses(index, s.q)])
    speed = np.linalg.norm(np.diff(place, axis=0), axis=1) / PERIOD
    assert speed.max() == pytest.approx(0.25, rel=1e-3)
    assert np.median(speed) == pytest.approx(0.25, rel=1e-3)
    free = lines.prepare(index, [lines.target([0.0, 0.4, 0.0])], speed=0.0)
    assert free.duration < 0.8 * s.q.shape[0] * PERIOD
    v = lines.ticks(free)
    limits = lines.limits.motion.of(index)
    used = [np.abs(v.v / limits.velocity).max(), np.abs(v.a / limits.acceleration).max()]
    used.append(np.abs(np.diff(v.a, axis=0) / PERIOD / limits.jerk).max())
    assert max(used) > 0.9  # some limit is what keeps it from going faster


def test_several_poses_rest_or_are_rounded(lines):
    corner, end = lines.target([0.0, 0.2, 0.0]), lines.target([0.0, 0.2, -0.2], (0.0, 0.0, 0.3))
    resting = lines.prepare(SIX, [corner, end])
    rounded = lines.prepare(SIX, [corner, end], blend=0.03)
    assert rounded.duration < resting.duration
    for trajectory, within in ((resting, 5e-5), (rounded, 0.03)):
        s = lines.ticks(trajectory)
        place = np.array([pose.translation for pose in lines.poses(SIX, s.q)])
        nearest = np.linalg.norm(place - corner[:3], axis=1).min()
        assert nearest <= within
        np.testing.assert_allclose(place[-1], end[:3], atol=1e-6)
        assert (np.abs(np.diff(s.a, axis=0)) / PERIOD <= lines.limits.motion.of(SIX).jerk * 1.01).all()
        points = [trajectory.point(t) for t in np.linspace(0.0, trajectory.duration, 50)]
        assert sorted(points) == points
        assert {points[0], points[-1]} == {0, 1}
    middle = np.abs(lines.ticks(rounded).v).max(axis=1)[20:-20]
    assert middle.min() > 0.02  # no rest at the corner


@pytest.mark.parametrize("blend", [0.0, 0.005, 0.01, 0.02, 0.03, 0.04, 0.06, 0.1])
def test_limits_hold_between_the_ticks_too(lines, blend):
    """At every instant, on both sides of a jump of jerk: what rounding puts a tick on must not decide."""
    corner, end = lines.target([0.0, 0.2, 0.0]), lines.target([0.0, 0.2, -0.2], (0.0, 0.0, 0.3))
    trajectory, limits = lines.prepare(SIX, [corner, end], blend=blend), lines.limits.motion.of(SIX)
    s = trajectory.span(np.linspace(0.0, trajectory.duration, 10_000))
    assert (np.abs(s.v) <= limits.velocity).all()
    assert (np.abs(s.a) <= limits.acceleration).all()
    x = trajectory.lengths[:, None, None] * np.linspace(0.0, 1.0, 17)[:, None]
    c3, c4, c5 = (trajectory.coefficients[:, None, k] for k in (3, 4, 5))
    assert (np.abs(6.0 * c3 + x * (24.0 * c4 + x * 60.0 * c5)) <= limits.jerk * 1.0005).all()


@pytest.mark.parametrize("period_s", [0.0045, 0.002, 0.001])
def test_setpoints_keep_the_limits_at_every_servo_period(lines, config, period_s):
    """What the loop follows, tick by tick: the trajectory at its knots, and quintics between."""
    servo, limits = config.at_period(period_s).servo, lines.limits.motion.of(SIX)
    trajectory = lines.prepare(SIX, [lines.target([0.0, 0.2, 0.1]), lines.target([0.1, 0.3, 0.0])], blend=0.05)
    planner = GroupPlanner(lines.start[SIX], period_s, servo.planning_divisor, limits)
    planner.follow(trajectory, 1.0)
    setpoints = [planner.setpoint]
    while not planner.finished:
        setpoints.append(planner.advance())
    v, a = np.array([s.v for s in setpoints]), np.array([s.a for s in setpoints])
    assert (np.abs(v) <= 1.001 * limits.velocity).all()
    assert (np.abs(a) <= 1.001 * limits.acceleration).all()
    assert (np.abs(np.diff(a, axis=0)) <= 1.001 * limits.jerk * period_s).all()
    np.testing.assert_allclose(setpoints[-1].q, trajectory.end_setpoint.q, atol=1e-12)


def test_a_pose_where_the_wrist_is_takes_no_time(lines):
    trajectory = lines.prepare(SIX, [lines.target([0.0, 0.0, 0.0])])
    assert trajectory.duration == 0.0
    np.testing.assert_array_equal(trajectory.at(1.0).q, lines.start[SIX])


def test_the_cart_helps_where_the_arm_cannot(lines):
    """Straight down the arm alone meets a joint limit; with its cart it gets there."""
    target = lines.target([0.0, 0.0, -0.4])
    with pytest.raises(LimitError):
        lines.prepare(SIX, [target])
    s = lines.ticks(lines.prepare(NINE, [target]))
    assert np.abs(s.q[-1, :3] - s.q[0, :3]).max() > 0.1


def test_preparing_twice_gives_the_same_bits(lines):
    first, second = (lines.prepare(NINE, [lines.target([0.2, 0.1, -0.1], (0.1, 0.2, 0.0))]) for _ in range(2))
    np.testing.assert_array_equal(first.coefficients, second.coefficients)
    np.testing.assert_array_equal(first.lengths, second.lengths)


def singular_wrist(lines):
    """A start from which joint 5 must pass 0 on a way straight through the wrist's singularity."""
    q = lines.start.copy()
    q[7] = 0.3
    return q


@pytest.mark.parametrize(
    ("step", "error", "code", "message", "facts"),
    [
        ([0.0, 0.0, -0.4], LimitError, "limit", r"left_j5: position on the line to pose 1 \(35\d\.\d mm of 400.0 mm, ",
         {"joint": "left_j5", "pose": 1, "unit": "rad"}),
        ([0.0, 0.0, 0.4], ImError, "unreachable", r"left_wrist leaves the arm's reach on the line to pose 1 \(37\d",
         {"pose": 1}),
        ([-0.4, 0.0, 0.0], ImError, "singular", r"shoulder singularity \(the wrist over the axis of left_j1\) on",
         {"singularity": "shoulder", "joint": "left_j1"}),
        ([0.4034, 0.0, 0.0], ImError, "singular", r"elbow singularity \(the arm stretched or folded at left_j3\)",
         {"singularity": "elbow", "joint": "left_j3"}),
    ],
)  # fmt: skip
def test_what_is_on_the_way_is_refused_beforehand(lines, step, error, code, message, facts):
    with pytest.raises(error, match=message) as caught:
        lines.prepare(SIX, [lines.target(step)])
    assert caught.value.code == code
    assert facts.items() <= caught.value.facts.items()
    place = np.array(caught.value.facts["position_m"])
    way = np.array(step)
    share = caught.value.facts["percent"] / 100.0
    np.testing.assert_allclose(place, lines.pose.translation + share * way, atol=1e-6)


def test_a_wrist_that_must_turn_over_is_refused(lines):
    """Turning about the wrist's own axis 5, through 0."""
    q = singular_wrist(lines)
    pose = lines.model.pose(q, "left_wrist")
    over = q.copy()
    over[7] = -0.3
    target = lines.model.pose(over, "left_wrist")
    values = [*target.translation, *pin.Quaternion(target.rotation).coeffs()]
    with pytest.raises(ImError, match=r"wrist singularity \(left_j5 at 0\) on the line to pose 1") as caught:
        lines.prepare(SIX, [values], start=q)
    assert caught.value.facts["joint"] == "left_j5"
    assert 25.0 < caught.value.facts["percent"] < 50.0
    np.testing.assert_allclose(caught.value.facts["position_m"], pose.translation, atol=1e-6)


def test_groups_without_an_arm_have_no_lines(lines):
    target = [lines.target([0.1, 0.0, 0.0])]
    with pytest.raises(StateError, match="no wrist"):
        lines.prepare(np.array([0, 1, 2]), target, frames=())
    with pytest.raises(StateError, match="needs left_j5, left_j6, not in the group"):
        lines.prepare(np.arange(3, 7), target)


@pytest.mark.parametrize("off", [2e-9, 1e-8, 1e-6, 1e-5, 1e-4, 9e-4])
@pytest.mark.parametrize("where", ["first", "last"])
def test_a_pose_all_but_in_the_place_of_another_costs_no_time(lines, off, where):
    """As a first pose that is measured, or read from text with few digits, is."""
    far = np.array([0.0, 0.1, 0.0])
    alone = lines.prepare(NINE, [lines.target(far)], speed=0.1)
    steps = [-off * far / 0.1, far] if where == "first" else [far, far * (1.0 + off / 0.1)]
    found = lines.prepare(NINE, [lines.target(step) for step in steps], speed=0.1, blend=0.02)
    assert found.duration == pytest.approx(alone.duration, rel=0.02)
    (end,) = lines.poses(NINE, [found.end_setpoint.q])
    np.testing.assert_allclose(end.translation, lines.target(steps[-1])[:3], atol=1e-6)


@pytest.mark.parametrize(("leg", "blend"), [(1.2e-3, 0.02), (0.05, 1e-9), (0.05, 5e-4)])
def test_in_a_corner_too_tight_to_be_rounded_it_rests(lines, leg, blend):
    poses = [lines.target(step) for step in ([0.0, leg, 0.0], [0.0, leg, -0.1])]
    found, resting = (lines.prepare(NINE, poses, speed=0.1, blend=b) for b in (blend, 0.0))
    np.testing.assert_array_equal(found.coefficients, resting.coefficients)


def test_every_pose_is_passed_within_the_blend(lines):
    random, blend = np.random.default_rng(4), 0.01
    steps = np.cumsum(10.0 ** random.uniform(-6.0, -2.0, (12, 1)) * random.normal(size=(12, 3)), axis=0)
    found = lines.prepare(NINE, [lines.target(step) for step in steps], blend=blend)
    passed = np.array([pose.translation for pose in lines.poses(NINE, lines.ticks(found).q)])
    for step in steps:
        assert np.linalg.norm(passed - lines.pose.translation - step, axis=1).min() < blend
