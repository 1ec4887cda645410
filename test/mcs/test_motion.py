"""Lines, blending, policies, pause, speed, protective stop, control laws and payload through ROS."""

import math
import threading

import numpy as np
import pytest
from geometry_msgs.msg import Inertia, Pose, Vector3
from visualization_msgs.msg import Marker, MarkerArray

from im_core.ros import qos
from im_msgs.srv import (
    ForwardKinematics,
    InverseKinematics,
    SetController,
    SetPayload,
    SetSpeed,
)
from support.motions import below, position

COMPUTED_TORQUE = "im_mcs.control.computed_torque:ComputedTorque"
STEP = np.array([0.05, 0.2, 0.1, 0.2, -0.2, 0.2, 0.3, 0.3, 0.3])


def test_kinematics_refuses_what_is_wrong(client):
    far = Pose()
    far.position.z, far.orientation.w = 9.0, 1.0
    answer = client.call(InverseKinematics, "inverse_kinematics", group="left", wrist=far)
    assert not answer.success
    assert "out of reach" in answer.status.message
    for q in ([0.0] * 8, [math.nan] * 9):
        assert not client.call(ForwardKinematics, "forward_kinematics", group="left", q=q).success
    answer = client.call(ForwardKinematics, "forward_kinematics", group="transporter")
    assert "group 'transporter' is not in the preset in force, 2x9 (left, right), but in 3x6" in answer.status.message


def test_wrong_lines_are_refused(ready):
    folded = ready.home.copy()
    folded[7] = 0.0
    assert ready.move(folded).success
    assert "wrist singularity (left_j5 at 0)" in ready.move(line=[below(ready, 0.1)]).status.message
    assert ready.move(ready.home + STEP).success
    here, before = ready.group_state().wrist, ready.group_state().q_rest
    far, nan, unnormed = Pose(), below(ready, 0.1), below(ready, 0.1)
    far.position.z, far.orientation.w = 9.0, 1.0
    nan.position.y = math.nan
    unnormed.orientation.w += 1.0
    for options, sentence in (
        ({"line": [far]}, "reach"),
        ({"line": [nan]}, "pose 1 of the line: the pose ["),
        ({"line": [unnormed]}, "unit quaternion"),
        ({"line": [here], "line_speed": -1.0}, "speed"),
        ({"line": [here], "line_speed": math.inf}, "line_speed is inf"),
    ):
        result = ready.move(**options)
        assert not result.success
        assert sentence in result.status.message
    assert "not both" in ready.move(ready.home, line=[here]).status.message
    assert ready.group_state().q_rest == before


def test_blending_saves_time(ready):
    points = [ready.home + STEP * k for k in (0.5, 1.0, 1.5, 2.0, 1.0, 0.0)]
    with_stops = ready.move(*points)
    blended = ready.move(*points, blend=0.1)
    assert blended.success, blended.status.message
    assert blended.duration < with_stops.duration - 0.5
    np.testing.assert_allclose(blended.state.q_rest, ready.home, atol=1e-4)


def test_speed(ready):
    full = ready.move(ready.home + STEP).duration
    assert ready.call(SetSpeed, "set_speed", group="left", scale=0.5).success
    half = ready.move(ready.home)
    assert half.success
    assert half.duration > 1.5 * full
    ready.until(lambda: ready.status().speed == pytest.approx(0.5))
    for scale in (0.0, -1.0, 1.5, math.nan):
        assert not ready.call(SetSpeed, "set_speed", group="left", scale=scale).success
    assert ready.call(SetSpeed, "set_speed", group="left", scale=1.0).success


def test_a_law_takes_over_in_the_middle_of_a_motion(ready):
    _, result = ready.start_far_move()
    answer = ready.call(SetController, "set_controller", group="left", controller=COMPUTED_TORQUE)
    assert answer.success, answer.message
    assert answer.message == f"{COMPUTED_TORQUE} takes over left"
    assert result().success
    ready.until(lambda: ready.status().controller == COMPUTED_TORQUE)
    softer = "{bandwidth_rad_s: 40.0}"
    answer = ready.call(SetController, "set_controller", group="left", parameters=softer)
    assert answer.success, answer.message
    assert ready.move(ready.home + 0.05).success
    for group, controller, parameters, sentence in (
        ("left", "os:system", "", "there is no control law 'os:system'"),
        ("lefft", COMPUTED_TORQUE, "", "did you mean 'left'"),
        ("right", COMPUTED_TORQUE, "", "group 'right' is not reserved"),
        ("left", "", "{bandwith_rad_s: 40.0}", "did you mean 'bandwidth_rad_s'"),
        ("left", "", "{bandwidth_rad_s: [", "parameters"),
        ("left", "", "40.0", "parameters"),
        ("left", "", "{bandwidth_rad_s: .nan}", "bandwidth_rad_s: nan has a number that is not finite"),
    ):
        given = {"group": group, "controller": controller, "parameters": parameters}
        answer = ready.call(SetController, "set_controller", **given)
        assert not answer.success
        assert sentence in answer.message


def test_payload(ready):
    payload = Inertia(m=1.0, com=Vector3(z=0.05), ixx=0.002, iyy=0.002, izz=0.001)
    answer = ready.call(SetPayload, "set_payload", group="left", payload=payload)
    assert answer.success, answer.message
    for wrong in (Inertia(m=-1.0), Inertia(m=math.nan), Inertia(m=99.0), Inertia(m=1.0, ixx=-1.0)):
        answer = ready.call(SetPayload, "set_payload", group="left", payload=wrong)
        assert not answer.success
        assert answer.message
    assert ready.call(SetPayload, "set_payload", group="left", payload=Inertia()).success
    assert ready.move(ready.home + STEP).success


def test_many_requests_at_once_are_all_answered(ready):
    """A client that asks while the arm moves: every question is answered, the motion ends as it would have."""
    _, result = ready.start_far_move()
    answers = []
    threads = [threading.Thread(target=lambda: answers.append(ready.group_state())) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    assert len(answers) == 8
    assert result().success


def test_markers_show_the_planned_path_of_the_wrist(ready):
    told = ready.listen(MarkerArray, "/markers", qos.LATCHED)
    far = ready.home + 0.05
    ends = [ready.call(ForwardKinematics, "forward_kinematics", group="left", q=q).wrist for q in (ready.home, far)]
    handle, result = ready.start_move(far, ready.home, far, ready.home, far)
    ready.until(lambda: told and told[-1].markers[0].action == Marker.ADD)
    left, right = told[-1].markers
    assert (left.ns, left.header.frame_id, right.action) == ("paths", "world", Marker.DELETE)
    first, last = ([left.points[n].x, left.points[n].y, left.points[n].z] for n in (0, -1))
    home, far_off = (np.array(position(end)) for end in ends)
    np.testing.assert_allclose(last, far_off, atol=1e-3)
    assert np.all(first > np.minimum(home, far_off) - 1e-3)  # drawn from where the arm is by then
    assert np.all(first < np.maximum(home, far_off) + 1e-3)
    ready.cancel(handle)
    result()
    ready.until(lambda: told[-1].markers[0].action == Marker.DELETE)
