"""Streaming setpoints: chased within limits, halted, and let go when the sender falls silent."""

import numpy as np
import pytest
from ruckig import Ruckig, RuckigError, Synchronization

from im_core.errors import DataError, ImError, LimitError, StateError
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.motions import stream
from im_mcs.planning.motions.stream import StreamFollower
from im_mcs.planning.trajectories import profile
from im_mcs.planning.trajectories.profile import Chase
from im_mcs.planning.trajectories.trajectory import Setpoint


def test_a_target_is_reached_and_held(rig, way):
    goal = rig.stream(rig.home + 0.3 * way)
    rig.ticks(600)
    np.testing.assert_allclose(rig.trace[-1].q, rig.home + 0.3 * way, atol=1e-12)
    assert [g.id for g in rig.group.goals] == [goal]
    rig.check_motion()


def test_the_newest_of_a_stream_of_targets_is_chased(rig, way):
    goal = rig.stream(rig.home)
    for k in range(1, 200):
        speed = 0.2 * way * np.cos(0.01 * k) * 0.01 / 0.009
        rig.stream(rig.home + 0.2 * way * np.sin(0.01 * k), velocities=speed.tolist(), lease_s=0.1)
        rig.ticks(2)
    assert goal not in rig.results
    assert np.abs(rig.trace[-1].q - rig.home - 0.2 * way * np.sin(0.01 * 199)).max() < 0.005
    rig.check_motion(jerk=1.6)


def test_a_target_with_a_velocity_moves_on(rig, way):
    rig.stream(rig.home, velocities=(0.1 * way).tolist())
    rig.ticks(300)
    expected = rig.home + 0.1 * way * 300 * rig.period
    np.testing.assert_allclose(rig.trace[-1].q, expected, atol=2e-3)
    np.testing.assert_allclose(rig.trace[-1].v, 0.1 * way, atol=1e-6)
    rig.check_motion(jerk=1.6)


def test_silence_beyond_the_lease_decelerates_and_ends_the_goal(rig, way):
    goal = rig.stream(rig.home + way, lease_s=0.2)
    rig.ticks(30)
    rig.stream(rig.home + way, lease_s=0.2)
    rig.ticks(44)  # 0.198 s
    assert rig.group.goals[0].fault is None
    rig.ticks(2)
    assert rig.group.goals[0].fault is not None
    rig.run()
    fault = rig.results[goal][0]
    assert fault.code == "lease"
    assert "'teleop' has sent no setpoint for 0.2 s" in fault.message
    assert not rig.trace[-1].v.any()
    assert np.abs(rig.trace[-1].q - rig.home - way).max() > 0.1
    rig.check_motion()


def test_a_stream_is_paused_slowed_and_cancelled(rig, way):
    goal = rig.stream(rig.home + way)
    rig.ticks(60)
    rig.group.pause()
    rig.ticks(200)
    assert not rig.trace[-1].v.any()
    where = rig.trace[-1].q
    rig.ticks(20)
    np.testing.assert_array_equal(rig.trace[-1].q, where)
    rig.group.set_speed(0.3)
    rig.group.resume()
    before = len(rig.trace)
    rig.ticks(200)
    assert (np.abs(rig.v[before:]) <= 0.3001 * rig.limits.velocity).all()
    rig.group.cancel(goal, ImError("enough", code="cancelled"))
    rig.run()
    assert rig.code(goal) == "cancelled"
    rig.check_motion()


def test_only_the_first_opens_a_goal_and_a_path_under_way_is_not_interrupted(rig, way):
    first = rig.goal()
    _, asked = rig.parse("stream", kind="setpoint", positions=rig.home.tolist(), lease_s=1.0)
    assert rig.group.stream(first, asked) is True
    assert rig.group.stream(rig.goal(), asked) is False
    assert rig.group.goals == (first,)
    rig.group.stop(ImError("enough"))
    rig.run()
    moving = rig.move(rig.home + way)
    rig.ticks(30)
    with pytest.raises(StateError, match=f"goal {moving}"):
        rig.stream(rig.home)


def test_setpoints_that_could_not_be_followed_are_refused(rig):
    q = rig.home.copy()
    q[3] = rig.all_limits.upper[3] - 0.01
    with pytest.raises(LimitError, match=r"left_j1: position at which it could stop"):
        rig.stream(q, velocities=[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(LimitError, match=r"left_j1: velocity of the setpoint"):
        rig.stream(rig.home, velocities=[0.0, 0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(ImError, match=r"velocities: 2 values for 9 joints"):
        rig.stream(rig.home, velocities=[0.0, 0.0])
    with pytest.raises(ImError, match=r"left_j1: position nan"):
        rig.stream(np.where(np.arange(9) == 3, np.nan, rig.home))
    assert rig.group.goals == ()
    assert not rig.group.moving


def test_a_velocity_that_is_the_limit_but_for_rounding_is_followed(rig):
    for joint in range(9):
        velocity = np.zeros(9)
        velocity[joint] = rig.limits.velocity[joint] * (1.0 + 9e-7)
        rig.stream(rig.home, velocities=velocity.tolist())
        rig.ticks(40)
        rig.stream(rig.home)
        rig.ticks(400)
    np.testing.assert_allclose(rig.trace[-1].q, rig.home, atol=1e-12)
    rig.check_motion()


# of a group slowed down to a tenth: ruckig synchronises no motion from this state to this target
UNSYNCHRONISED = {
    "start": Setpoint(
        q=np.array([-0.5999357033799571, -0.0003167262, -0.000159993771997483, -8.171614992960431e-10,
                    1.748504112827027, -3.300814303775843, -0.002399054048656251, 0.3018932492573633,
                    -0.004338714111550299]),
        v=np.array([0.001286161651019102, -0.0150822, -0.004642921555441066, 0.0, -0.0616022908017395,
                    -0.01800473741794386, -0.05543568249166355, 0.04115195071595902, -0.134344258471209]),
        a=np.array([0.0, -0.4788, 0.0, 0.0, -0.9452336978878904, 0.0, 0.0, 0.0, 0.0]),
    ),
    "limits": MotionLimits(
        velocity=np.array([0.057, 0.07600000000000001, 0.0475, 0.13585, 0.12255, 0.20235, 0.3781, 0.399, 0.3781]),
        acceleration=np.array([0.95, 1.14, 0.76, 3.8, 3.8, 5.699999999999999, 14.25, 14.25, 14.25]),
        jerk=np.array([7.6, 7.6, 5.699999999999999, 38.0, 38.0, 57.0, 142.5, 142.5, 142.5]),
    ),
    "target": np.array([-0.5555560660579975, -2.612993877991495, -0.1602941637438641, -8.171614992960431e-10,
                        -0.7803981633974483, -3.921990815621379, -1.914862177193763, 0.9529180547556717,
                        -4.637575810304917]),
}  # fmt: skip


def test_a_target_that_the_joints_cannot_reach_together_is_reached_by_each(rig):
    start, limits, target = (UNSYNCHRONISED[name] for name in ("start", "limits", "target"))
    with pytest.raises(DataError, match="ruckig"):
        Chase(start, target, np.zeros(9), limits, together=True)
    follower = StreamFollower(start, limits, np.full(9, -9.0), np.full(9, 9.0), rig.period, 2)
    follower.renew(target, np.zeros(9))
    trace = [start] + [follower.advance(1.0)[0] for _ in range(10_000)]
    assert follower.fault is None
    np.testing.assert_array_equal(trace[-1].q, target)
    q, v, a = (np.array([getattr(s, name) for s in trace]) for name in ("q", "v", "a"))
    assert (np.abs(v) <= np.maximum(limits.velocity, np.abs(start.v)) + 1e-9).all()
    assert (np.abs(a) <= limits.acceleration + 1e-9).all()
    assert (np.abs(np.diff(q, axis=0)) <= 2.0 * rig.period * np.abs(v).max(axis=0) + 1e-9).all()


def test_joints_that_meet_moving_targets_one_by_one_move_on_with_them(rig):
    start, velocity = Setpoint.at_rest(rig.home), 0.1 * rig.limits.velocity
    chase = Chase(start, rig.home + np.linspace(0.1, 0.9, 9), velocity, rig.limits, together=False)
    assert len(set(chase.durations)) > 1
    last = chase.durations.max()
    before, after = chase.at(last - 1e-9), chase.at(last + 1e-9)
    np.testing.assert_allclose(after.q, before.q, atol=1e-8)
    np.testing.assert_allclose(after.q, rig.home + np.linspace(0.1, 0.9, 9) + velocity * last, atol=1e-8)
    np.testing.assert_allclose(after.v, velocity, atol=1e-12)


@pytest.mark.parametrize("ticks", [1, 5])
def test_slow_joints_of_different_limits_follow_a_sine(rig, ticks):
    """A target that turns is not where its velocity pointed: joints that made for that place swung 100 mm too far."""
    velocity = np.array([0.76, 0.475, 0.285, 1.9])
    limits = MotionLimits(velocity, velocity / 0.25, velocity / 0.025)
    follower = StreamFollower(Setpoint.at_rest(np.zeros(4)), limits, np.full(4, -1.0), np.full(4, 1.0), rig.period, 1)
    off = []
    for k in range(1000):
        phase = 2.0 * rig.period * k
        if k % ticks == 0:
            follower.renew(np.full(4, 0.1 * np.sin(phase)), np.full(4, 0.2 * np.cos(phase)))
        off.append(np.abs(follower.advance(1.0)[0].q - 0.1 * np.sin(phase + 2.0 * rig.period)).max())
    assert max(off) < 0.035, "the way of the slowest joint from rest to the velocity of the target"
    assert max(off[300:]) < 2e-3


def test_a_stream_to_which_no_motion_is_found_ends_on_the_way_and_says_why(rig, way, monkeypatch):
    goal = rig.stream(rig.home + way)
    rig.ticks(60)
    assert (rig.trace[-1].v != 0.0).any()

    def none_found(*_, **__):
        raise DataError("no trajectory")

    monkeypatch.setattr(stream, "Chase", none_found)
    rig.stream(rig.home)
    rig.run()
    assert rig.results[goal][0].message == "no trajectory"
    assert not rig.trace[-1].v.any()
    rig.check_motion()


def test_each_joint_comes_to_rest_by_itself_where_they_cannot_together(rig, way, monkeypatch):
    rig.stream(rig.home + way)
    rig.ticks(60)

    class Alone(Ruckig):
        def calculate(self, asked, trajectory):
            if asked.synchronization is not Synchronization.No:
                raise RuckigError("error in step 2")
            return super().calculate(asked, trajectory)

    monkeypatch.setattr(profile, "Ruckig", Alone)
    rig.group.pause()
    rig.ticks(300)
    assert not rig.trace[-1].v.any()
    rig.check_motion()
