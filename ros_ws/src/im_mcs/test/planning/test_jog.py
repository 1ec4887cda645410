"""Jogs: wanted velocities of joints or wrist are followed within limits, and let go when the sender falls silent."""

import numpy as np
import pytest

from im_core.errors import DataError, ImError, NotFoundError, StateError
from im_mcs.inverse.arm import Arm
from im_mcs.inverse.tracking import ArmTracker
from im_mcs.planning.motions.jog import JogLimit

NONE = [0.0] * 9


def jog(rig, velocities, lease_s=10.0, **more):
    goal = rig.goal()
    given = {"kind": "jog", "velocities": [float(v) for v in velocities], "lease_s": lease_s, **more}
    rig.group.stream(goal, rig.parse("stream", **given)[1])
    return goal.id


def twist(rig, *velocities, frame="world", **more):
    return jog(rig, velocities, kind="twist", frame=frame, **more)


@pytest.fixture
def bent(rig):
    """The rig far from singularities."""
    q = rig.home.copy()
    q[3:] = 0.7, 1.08, -3.0, 0.26, -0.79, -0.94
    rig.q_all[rig.index] = q
    rig.group.engage(q)
    rig.trace = [rig.group.planner.setpoint]
    return rig


def poses(rig):
    whole = rig.q_all.copy()
    for setpoint in rig.trace:
        whole[rig.index] = setpoint.q
        yield rig.context.model.pose(whole, "left_wrist")


def test_joints_take_up_the_wanted_velocity_and_keep_it(rig, way):
    goal = jog(rig, 0.1 * way)
    rig.ticks(400)
    np.testing.assert_allclose(rig.trace[-1].v, 0.1 * way, atol=1e-9)
    assert [g.id for g in rig.group.goals] == [goal]
    assert rig.group.jog_limit is JogLimit.NONE
    rig.check_motion()


def test_the_newest_velocity_wins_whatever_was_before(rig, way):
    jog(rig, 0.3 * way)
    rig.ticks(61)  # between two knots
    jog(rig, -0.3 * way)
    rig.ticks(61)
    twist(rig, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0)
    rig.ticks(61)
    rig.stream(rig.home)
    rig.ticks(900)
    np.testing.assert_allclose(rig.trace[-1].q, rig.home, atol=1e-9)
    assert len(rig.group.goals) == 1
    rig.check_motion()


def test_silence_beyond_the_lease_ramps_down_and_ends_the_goal(rig, way):
    goal = jog(rig, 0.3 * way, lease_s=0.1)
    rig.ticks(23)  # 0.1035 s
    assert rig.group.goals[0].fault.code == "lease"
    ramp_s = (0.3 * np.abs(way) / rig.limits.acceleration + rig.limits.acceleration / rig.limits.jerk).max()
    rig.ticks(int(ramp_s / rig.period) + 4)
    assert not rig.trace[-1].v.any()
    rig.run()
    assert "the sender has sent no velocity for 0.1 s" in rig.results[goal][0].message
    rig.check_motion()


def test_after_a_silence_the_next_command_need_not_wait_for_rest(rig, way):
    first = jog(rig, 0.3 * way, lease_s=0.1)
    rig.ticks(40)
    assert rig.trace[-1].v.any()
    second = jog(rig, 0.3 * way)
    rig.ticks(300)
    assert rig.code(first) == "lease"
    assert [g.id for g in rig.group.goals] == [second]
    np.testing.assert_allclose(rig.trace[-1].v, 0.3 * way, atol=1e-9)
    rig.check_motion()


def test_a_command_beyond_the_limits_keeps_its_direction(rig):
    wanted = np.array([0.0] * 6 + [30.0, 10.0, -20.0])
    jog(rig, wanted)
    rig.ticks(100)
    assert rig.group.jog_limit is JogLimit.VELOCITY
    v = rig.trace[-1].v
    assert np.abs(v / rig.limits.velocity).max() == pytest.approx(1.0)
    np.testing.assert_allclose(v / np.linalg.norm(v), wanted / np.linalg.norm(wanted), atol=1e-9)
    rig.check_motion()


@pytest.mark.parametrize("joint", range(9))
@pytest.mark.parametrize("speed", [-1.0, -0.3, 1.0])
def test_a_joint_stops_at_the_end_of_its_range_and_comes_back(rig, joint, speed):
    velocity = np.zeros(9)
    velocity[joint] = speed * rig.limits.velocity[joint]
    jog(rig, velocity, lease_s=10.0)
    for _ in range(120):
        jog(rig, velocity, lease_s=10.0)
        rig.ticks(100)
        if rig.group.jog_limit is JogLimit.JOINT_RANGE and np.abs(rig.trace[-1].v).max() < 1e-4:
            break
    lower, upper = rig.all_limits.lower[rig.index], rig.all_limits.upper[rig.index]
    assert ((rig.q >= lower - 1e-12) & (rig.q <= upper + 1e-12)).all()
    end = (upper if speed > 0.0 else lower)[joint]
    assert rig.trace[-1].q[joint] == pytest.approx(end, abs=1e-3)
    jog(rig, -velocity)
    rig.ticks(100)
    assert rig.trace[-1].v[joint] * speed < 0.0
    rig.check_motion()


def test_random_commands_leap_nowhere_and_leave_no_range(rig):
    random = np.random.default_rng(4)
    lower, upper = rig.all_limits.lower[rig.index], rig.all_limits.upper[rig.index]
    for _ in range(150):
        if random.random() < 0.5:
            jog(rig, random.uniform(-1.5, 1.5, 9) * rig.limits.velocity)
        else:
            twist(rig, *random.uniform(-0.5, 0.5, 6), frame=random.choice(["world", "left_wrist", "left_link2"]))
        if random.random() < 0.1:
            rig.group.pause()
        else:
            rig.group.resume()
        rig.group.set_speed(random.choice([0.0, 0.05, 0.5, 1.0]))
        rig.ticks(int(random.integers(1, 150)))
    assert ((rig.q >= lower - 1e-12) & (rig.q <= upper + 1e-12)).all()
    rig.check_motion()


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("frame", ["world", "left_wrist"])
def test_a_twist_moves_the_wrist_straight_along_an_axis_of_its_frame(bent, axis, frame):
    velocity = np.zeros(6)
    velocity[axis] = 0.08
    first = next(poses(bent))
    direction = (np.eye(3) if frame == "world" else first.rotation)[:, axis]
    twist(bent, *velocity, frame=frame)
    bent.ticks(300)
    assert bent.group.jog_limit is JogLimit.NONE
    way = np.array([pose.translation - first.translation for pose in poses(bent)])
    along = way @ direction
    assert along[-1] == pytest.approx(0.08 * 300 * bent.period, rel=0.15)
    assert np.abs(way - np.outer(along, direction)).max() < 1e-3
    assert all(np.abs(pose.rotation - first.rotation).max() < 2e-3 for pose in poses(bent))
    carriers = bent.q[:, :3] - bent.home[:3]
    assert not carriers.any()
    bent.check_motion()


@pytest.mark.parametrize("axis", range(3))
def test_a_twist_turns_the_wrist_in_its_place(bent, axis):
    velocity = np.zeros(6)
    velocity[3 + axis] = 0.3
    first = next(poses(bent))
    twist(bent, *velocity, frame="left_wrist")
    bent.ticks(200)
    *_, last = poses(bent)
    assert max(np.linalg.norm(pose.translation - first.translation) for pose in poses(bent)) < 1e-3
    turn = first.rotation.T @ last.rotation
    assert turn[axis, axis] == pytest.approx(1.0, abs=2e-3)
    assert turn[(axis + 2) % 3, (axis + 1) % 3] == pytest.approx(np.sin(0.3 * 200 * bent.period), rel=0.1)
    bent.check_motion()


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, 0, -1), (1, 1, 1)])
def test_a_twist_slows_down_before_a_singularity_stops_and_comes_back(rig, direction):
    tracker = ArmTracker(rig.context.model, Arm(rig.context.model, "left_wrist"), "left_wrist")
    velocity = 0.3 * np.array(direction) / np.linalg.norm(direction)
    told = set()
    for _ in range(100):
        twist(rig, *velocity, 0.0, 0.0, 0.0)
        rig.ticks(40)
        told.add(rig.group.jog_limit)
        if not np.abs(rig.trace[-1].v).max() > 1e-4 and len(rig.trace) > 100:
            break
    assert told & {JogLimit.SINGULARITY, JogLimit.SINGULARITY_AHEAD, JogLimit.JOINT_RANGE}
    whole, least = rig.q_all.copy(), rig.context.config.planning.line.singular_value
    for setpoint in rig.trace:
        whole[rig.index] = setpoint.q
        assert tracker.singular_value(whole) > 0.9 * least
    stopped = whole.copy()
    twist(rig, *-velocity, 0.0, 0.0, 0.0)
    rig.ticks(400)
    assert np.abs(rig.q_all - stopped).max() > 0.01
    rig.check_motion()


def test_a_pause_and_a_protective_stop_hold_and_say_so(rig, way):
    goal = jog(rig, 0.2 * way)
    rig.ticks(100)
    rig.group.pause()
    rig.ticks(200)
    assert rig.group.jog_limit is JogLimit.HELD
    assert not rig.trace[-1].v.any()
    rig.group.resume()
    rig.ticks(200)
    np.testing.assert_allclose(rig.trace[-1].v, 0.2 * way, atol=1e-9)
    rig.group.protective_stop(ImError("too close", code="collision"))
    rig.ticks(200)
    assert rig.group.jog_limit is JogLimit.COLLISION
    assert not rig.trace[-1].v.any()
    rig.group.resume()
    rig.group.rates.set_ceiling(0.5)
    rig.ticks(200)
    assert rig.group.jog_limit is JogLimit.COLLISION_AHEAD
    np.testing.assert_allclose(rig.trace[-1].v, 0.1 * way, atol=1e-9)
    rig.group.cancel(goal, ImError("enough", code="cancelled"))
    rig.run()
    assert rig.code(goal) == "cancelled"
    rig.check_motion()


def test_a_jog_is_refused_while_a_motion_is_under_way(rig, way):
    moving = rig.move(rig.home + way)
    rig.ticks(30)
    with pytest.raises(StateError, match=f"goal {moving}"):
        jog(rig, NONE)


@pytest.mark.parametrize(
    ("given", "kind", "message"),
    [
        ({"velocities": [0.1]}, DataError, "1 velocitys for 9 joints"),
        ({"velocities": [*NONE[1:], np.nan]}, DataError, "left_j6: velocity nan is not a finite number"),
        ({"velocities": [*NONE[1:], -1e308]}, DataError, "the jog has a velocity beyond 1e\\+06"),
        ({"kind": "twist", "velocities": NONE, "frame": "world"}, DataError, "the twist has 9 values, not 6"),
        ({"kind": "twist", "velocities": [np.inf] * 6, "frame": "world"}, DataError, "not a finite number"),
        ({"kind": "twist", "velocities": NONE[:6]}, DataError, "the twist names no frame"),
        ({"kind": "twist", "velocities": NONE[:6], "frame": "hat"}, NotFoundError, "frame 'hat'"),
    ],
)
def test_what_is_no_jog_changes_nothing(rig, way, given, kind, message):
    jog(rig, 0.1 * way)
    rig.ticks(200)
    with pytest.raises(kind, match=message):
        jog(rig, **given)
    rig.ticks(100)
    np.testing.assert_allclose(rig.trace[-1].v, 0.1 * way, atol=1e-9)


def test_a_group_without_a_wrist_has_no_twist(make_rig):
    rig = make_rig(name="transporter", preset="3x6")
    with pytest.raises(StateError, match="a twist needs a group with a wrist"):
        twist(rig, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0)
    jog(rig, [0.05] + [0.0] * 5)
    rig.ticks(200)
    assert rig.trace[-1].v[0] == pytest.approx(0.05)
