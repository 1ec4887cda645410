"""Streaming setpoints: chased within limits, halted, and let go when the sender falls silent."""

import numpy as np
import pytest

from im_core.errors import ImError, LimitError, StateError


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
