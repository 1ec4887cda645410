"""A session with ``/mcs``: states, topics, moves, wrong goals."""

import math

import numpy as np

from im_cell.robot import load_cell
from im_msgs.srv import ReserveGroup

STEP = np.array([0.05, 0.2, 0.1, 0.2, -0.2, 0.2, 0.3, 0.3, 0.3])


def test_a_session(client):
    target = client.home + STEP
    assert client.lifecycle() == "inactive"
    answer = client.trigger("power_on")
    assert not answer.success
    assert "power_on is refused in state cold; allowed here: cleanup, reserve" in answer.message
    answer = client.call(ReserveGroup, "reserve", group="lefft")
    assert "there is no group 'lefft'; did you mean 'left'?" in answer.message
    client.to_motion()
    assert client.lifecycle() == "active"
    client.until(lambda: client.state() == "motion" and not client.states[-1].brakes)
    assert list(client.states[-1].reserved_groups) == ["left"]

    told = []
    result = client.move(target, feedback=lambda m: told.append(m.feedback.progress))
    assert result.success, result.status.message
    assert told == sorted(told)
    state = result.state
    assert state.at_rest
    np.testing.assert_allclose(state.q_rest, target, atol=1e-4)
    covariance = np.array(state.q_rest_covariance).reshape(9, 9)
    assert (np.sqrt(np.diag(covariance)) > 0).all()
    assert (np.sqrt(np.diag(covariance)) < 1e-4).all()
    assert len(state.jacobian) == 54
    assert state.rest_window == 44

    stamp = state.stamp
    again = client.group_state()
    assert again.q_rest == state.q_rest
    assert again.stamp == stamp  # asking lets no time pass

    assert client.trigger("disable_motion").success
    assert client.trigger("power_off").success
    assert client.lifecycle() == "inactive"
    assert client.call(ReserveGroup, "release", group="left").success
    client.until(lambda: client.state() == "cold")


def test_standard_topics(ready):
    assert ready.move(ready.home + STEP).success
    ready.until(lambda: ready.description and len(ready.frames) > 22 and len(ready.positions) > 20)
    cell, told = load_cell(), ready.positions[-1]
    assert tuple(told.name) == (*cell.joint_names, "left_gripper", "right_gripper")
    assert list(told.position[18:]) == [cell.gripper.initial] * 2
    assert np.isfinite([*told.velocity, *told.effort]).all()
    assert list(told.velocity[18:]) == [0.0, 0.0]
    moving = [t for m in ready.frames for t in m.transforms if t.child_frame_id == "left_link6"]
    for published in (ready.positions[-20:], moving[-20:]):  # in time of the cell, however fast that passes
        stamps = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in published]
        np.testing.assert_allclose(np.diff(np.unique(stamps)), 0.02, atol=0.0046)  # the last one comes again at rest
    assert "left_j1" in ready.description[-1].data
    children = {t.child_frame_id for m in ready.frames for t in m.transforms}
    assert {"left_link6", "left_wrist", "left_led", "left_palm", "right_jaw_2", "wall_body"} <= children


def test_wrong_goals_say_why_and_move_nothing(ready):
    home, before = ready.home, ready.group_state().q_rest
    wide, nan = home.copy(), home.copy()
    wide[3], nan[4] = 3.0, math.nan
    for points, options, message in (
        ([wide], {}, "left_j1: position of point 1 3 rad is beyond the limit 2.787"),
        ([nan], {}, "point 1: position of left_j2 is nan, not a finite number"),
        ([home[:8]], {}, "point 1: position is given for 8 joints, 9 are needed"),
        ([], {}, "the path of group 'left' has no points"),
        ([home], {"names": [f"left_j{k}" for k in range(1, 10)]}, "there is no joint of group 'left' 'left_j7'"),
        ([home], {"policy": 3}, "policy 3 is not one of 0 (refuse), 1 (append), 2 (replace)"),
        ([home], {"speed_scale": math.nan}, "speed_scale is nan, not a finite number"),
        ([home], {"speed_scale": 1.5}, "speed_scale"),
        ([home], {"blend": -1.0}, "blend"),
        ([home], {"line_speed": 0.1}, "line_speed 0.1 m/s is for a line"),
        ([home], {"group": "right"}, "group 'right' is not reserved"),
    ):
        result = ready.move(*points, **options)
        assert not result.success
        assert message in result.status.message
    assert ready.group_state().q_rest == before
