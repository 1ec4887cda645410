"""Stops, faults and motions of machines of two cells, one machine a cell."""

import os
import signal

import numpy as np
import pytest
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_cell.link import PanelEnd, ServoEnd, StopEnd
from im_core import names
from im_core.ros import qos
from im_core.ros.calls import call_blocking
from im_msgs.action import Move
from im_msgs.msg import GroupPath, GroupSetpoints
from im_msgs.srv import CheckPath, GroupCommand, InjectFault, InverseKinematics, ReserveGroup
from support.motions import below, dead, far, forward, goal, now, position, started, trajectory

CAUSE = "request on /mcs/estop"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
Result = FollowJointTrajectory.Result


@pytest.fixture(scope="module", params=["puma_pair", "ur5"])
def cell_name(request):
    return request.param


def test_cold(client):
    assert client.trigger("estop").message.startswith("MCS is estopped")
    client.until(lambda: client.state() == "estopped" and CAUSE in client.states[-1].reason)
    reserved = client.call(ReserveGroup, "reserve", group=client.group)
    for refusal in (reserved.message, client.trigger("power_on").message):
        assert "is refused in state estopped; allowed here: reset, protective_stop, estop" in refusal
        assert refusal.endswith(f"; the cause of this state: {client.states[-1].reason}")
    assert client.trigger("estop").success  # once more
    assert client.trigger("reset").message == "MCS is cold"
    client.to_motion()


def test_a_circuit_that_is_found_cut_is_an_estop(client):
    assert client.change("cleanup")
    with StopEnd.attach(names.instance(), 60.0) as circuit:
        circuit.cut()
        assert client.change("configure")
        client.until(lambda: client.state() == "estopped" and "circuit was found cut" in client.states[-1].reason)
        assert client.lifecycle() == "inactive"
        assert client.trigger("reset").success
        assert not circuit.is_cut


def test_a_servo_that_has_just_begun_to_hang_is_not_waited_for(client, panel, testbed):
    client.to_motion()
    _, result = client.start_far_move(speed_scale=0.02)
    pid = panel.servo_pid
    os.kill(pid, signal.SIGSTOP)
    try:
        answer = client.trigger("estop")
        assert answer.success
        assert answer.message.startswith("MCS is estopped; the stop circuit of testbed is cut; power is ")
        assert answer.message.endswith("; the servo has not answered")
        client.until(lambda: dead(testbed))
        client.until(lambda: client.state() == "estopped" and not client.states[-1].power)
        assert client.lifecycle() == "inactive"
        assert not client.trigger("reset").success
    finally:
        os.kill(pid, signal.SIGCONT)
    assert not result().success
    client.until(lambda: panel.servo_pid == pid)
    client.until(lambda: client.trigger("reset").success)
    client.to_motion()


@pytest.mark.parametrize(
    ("fault", "rank", "sentence"),
    [
        ("encoder_nan", 4, "encoder_nan of {}"),
        ("encoder_frozen", -4, "encoder_frozen of {}"),
        ("brake_stuck", 3, "brake_stuck of {}"),
        ("brake_open", -6, "brake open of {}"),
        ("power_loss", None, "power_loss"),
    ],
)
def test_reset_waits_until_what_is_broken_is_mended(client, panel, fault, rank, sentence):
    joint = "" if rank is None else client.cell.joint_names[rank]
    service = client.node.create_client(InjectFault, "/testbed/inject_fault")

    def inject(active):
        request = InjectFault.Request(fault=fault, joint=joint, active=active)
        assert call_blocking(service, request, 60.0, "fault").success
        panel.wait_tick(panel.request_time(2), 60.0)

    assert client.trigger("estop").success
    inject(True)
    answer = client.trigger("reset")
    inject(False)
    assert not answer.success
    assert sentence.format(joint) in answer.message
    assert client.trigger("reset").success


def test_estop_in_the_middle_of_a_move(client):
    client.to_motion()
    _, result = client.start_far_move()
    assert client.trigger("estop").success
    message = result().status.message
    assert "request on /mcs/estop" in message
    client.until(lambda: client.state() == "estopped")
    assert client.lifecycle() == "inactive"
    assert "request on /mcs/estop" in client.states[-1].reason
    assert "allowed here: reset" in client.trigger("power_on").message
    assert client.trigger("reset").success
    assert client.call(ReserveGroup, "reserve", group=client.group).success
    assert client.trigger("power_on").success
    stopped = client.group_state().q
    assert client.trigger("enable_motion").success
    np.testing.assert_allclose(client.group_state().q_rest, stopped, atol=2e-4)  # the arm never leaps
    assert client.move(client.home).success


def test_cancel(client):
    client.to_motion()
    handle, result = client.start_far_move()
    client.cancel(handle)
    answer = result()
    assert answer.status.code == "cancelled"
    assert answer.state.at_rest
    assert client.move(client.home).success


def test_deactivate_ends_the_goal_at_rest_and_takes_the_power(client):
    client.to_motion()
    _, result = client.start_far_move()
    assert client.change("deactivate")
    assert "the motion was ended: motion of its group is being disabled" in result().status.message
    client.until(lambda: (client.state(), client.states[-1].power) == ("reserved", False))
    assert client.lifecycle() == "inactive"


def test_a_killed_servo_ends_the_goal_and_the_testbed_brakes(client):
    client.to_motion()
    _, result = client.start_far_move()
    panel, end = PanelEnd.attach(names.instance(), 60.0), ServoEnd.attach(names.instance(), 60.0)
    os.kill(panel.servo_pid, signal.SIGKILL)
    assert "the process im_mcs.servo ended with code -9" in result().status.message
    client.until(lambda: client.state() == "unconfigured")
    panel.request_time(2)
    client.until(lambda: end.read_state().brakes.all() and not end.read_state().power)
    assert client.lifecycle() == "unconfigured"
    panel.close()
    end.close()
    assert client.change("configure")
    client.until(lambda: client.state() == "cold")


def test_forward_and_inverse_kinematics_agree(ready):
    assert forward(ready, []) == ready.group_state().wrist
    pose = below(ready, 0.15)
    answer = ready.call(InverseKinematics, "inverse_kinematics", group=ready.group, wrist=pose, avoid_collisions=True)
    assert answer.success, answer.status.message
    np.testing.assert_allclose(position(forward(ready, answer.q)), position(pose), atol=1e-5)
    points = [JointTrajectoryPoint(positions=q) for q in (ready.group_state().q_rest, answer.q)]
    free = ready.call(CheckPath, "check_path", group=ready.group, path=JointTrajectory(points=points))
    assert free.success
    assert free.clearance > 0.02
    result = ready.move(answer.q)
    assert result.success
    assert result.state.wrist.position.z == pytest.approx(pose.position.z, abs=5e-4)


def test_a_line_is_straight(ready):
    begin = position(ready.group_state().wrist)
    paths = ready.listen(GroupPath, f"/{ready.group}/path")
    setpoints = ready.listen(GroupSetpoints, f"/{ready.group}/setpoints")
    target = below(ready, 0.15)
    result = ready.move(line=[target], line_speed=0.1)
    assert result.success, result.status.message
    assert result.duration > 1.5
    np.testing.assert_allclose(position(result.state.wrist), position(target), atol=5e-4)
    assert {path.kind for path in paths} >= {"line", ""}
    ready.until(lambda: setpoints)
    way = position(target) - begin
    for setpoint in setpoints[:: max(1, len(setpoints) // 10)]:
        offset = position(forward(ready, setpoint.position)) - begin
        assert np.linalg.norm(np.cross(offset, way)) / np.linalg.norm(way) < 5e-4


def test_policies(ready):
    _, first = ready.start_far_move(speed_scale=0.3)  # under way still when a busy computer comes to the second request
    refused = ready.move(ready.home)
    assert not refused.success
    assert refused.status.code == "state"
    result = ready.move(ready.home, policy=Move.Goal.REPLACE)
    assert result.success, result.status.message
    assert not first().success
    np.testing.assert_allclose(result.state.q_rest, ready.home, atol=1e-4)

    _, first = ready.start_move(ready.home + ready.step, speed_scale=0.5)
    result = ready.move(ready.home, policy=Move.Goal.APPEND)
    assert first().success
    assert result.success, result.status.message
    np.testing.assert_allclose(result.state.q_rest, ready.home, atol=1e-4)


def test_pause_and_resume(ready):
    _, result = ready.start_far_move()
    answer = ready.call(GroupCommand, "pause", group=ready.group)
    assert answer.success, answer.message
    ready.until(lambda: ready.status().paused and ready.status().speed == 0.0)
    assert list(ready.states[-1].paused_groups) == [ready.group]
    held = ready.group_state().q
    assert ready.status().moving
    np.testing.assert_allclose(ready.group_state().q, held, atol=1e-3)
    answer = ready.call(GroupCommand, "resume")
    assert answer.success, answer.message
    assert result().success


def test_protective_stop_is_named_logged_and_resumed(ready):
    log = ready.listen(Log, "/rosout", qos.EVENTS)
    _, result = ready.start_far_move()
    answer = ready.trigger("protective_stop")
    assert answer.success, answer.message
    ready.until(lambda: ready.states[-1].protective_stop)
    assert "request on /mcs/protective_stop" in ready.states[-1].protective_stop
    sentence = f"group '{ready.group}' decelerates and holds: protective stop: request on /mcs/protective_stop"
    ready.until(lambda: [entry for entry in log if entry.msg.startswith(sentence)])
    assert ready.state() == "motion"
    answer = ready.call(GroupCommand, "resume")
    assert answer.success, answer.message
    assert result().success
    ready.until(lambda: not ready.states[-1].protective_stop)


def test_a_start_to_come_is_waited_for(ready):
    begin = now(ready) + 1.0
    answer = ready.follow(goal(ready, (1.0, ready.home + ready.step), start=begin))[1]()
    assert answer.status == SUCCEEDED, answer.result.error_string
    assert now(ready) >= begin + 1.0


def test_path_tolerance_and_evidence(ready):
    request = far(ready)
    request.path_tolerance = [JointTolerance(name=ready.joints[0], position=1e-7)]
    answer = ready.follow(request)[1]()
    assert answer.status == ABORTED
    assert answer.result.error_code == Result.PATH_TOLERANCE_VIOLATED
    assert ready.joints[0] in answer.result.error_string
    assert "tick" in answer.result.error_string
    path = answer.result.error_string.rpartition(" ")[2]
    record = np.load(path)
    assert list(record["joints"][: len(ready.joints)]) == ready.joints
    assert record["q"].shape == (len(record["tick"]), len(ready.cell.joints))
    assert np.abs(record["following_error"][:, 0]).max() > 1e-7
    assert ready.move(ready.home).success


def test_cancel_decelerates_on_the_path(ready):
    handle, result = started(ready, far(ready, 60.0))
    ready.until(lambda: ready.group_state().q[0] > ready.home[0] + 1e-3)
    ready.cancel(handle)
    answer = result()
    assert answer.status == CANCELED
    assert answer.result.error_code == Result.SUCCESSFUL
    state = ready.group_state()
    assert state.at_rest
    offset = np.array(state.q_rest) - ready.home
    assert 0.0 < offset[0] < 1.0
    np.testing.assert_allclose(offset[1:], 0.0, atol=1e-4)


def test_a_new_goal_replaces_the_running_one(ready):
    _, first = started(ready, far(ready, 60.0))
    answer = ready.follow(goal(ready, (4.0, ready.home)))[1]()
    assert answer.status == SUCCEEDED, answer.result.error_string
    assert first().status == ABORTED
    assert first().result.error_code == Result.INVALID_GOAL
    np.testing.assert_allclose(ready.rest(), ready.home, atol=1e-4)


def test_an_invalid_second_goal_leaves_the_first_alone(ready):
    handle, first = started(ready, far(ready, 60.0))
    answer = ready.follow(goal(ready, (1.0, ready.home[:3])))[1]()
    assert answer.status == ABORTED
    assert answer.result.error_code == Result.INVALID_GOAL
    assert not ready.group_state().at_rest
    ready.cancel(handle)
    assert first().status == CANCELED


def test_the_topic_replaces_stops_and_counts_what_it_refuses(ready):
    publisher = ready.talk(JointTrajectory, f"/{ready.group}/joint_trajectory")
    _, result = started(ready, far(ready, 60.0))
    publisher.publish(trajectory(ready, (40.0, ready.home - 0.2 * np.eye(len(ready.home))[0])))
    assert result().status == ABORTED
    publisher.publish(JointTrajectory())
    ready.until(lambda: ready.group_state().at_rest)
    assert ready.group_state().q_rest[0] > ready.home[0] - 0.19

    diagnostics = ready.listen(DiagnosticArray, "/diagnostics")
    publisher.publish(trajectory(ready, (1.0, ready.home), joints=[ready.joints[1]]))

    def refused():
        statuses = [s for m in diagnostics for s in m.status if s.name == "mcs: refused messages"]
        return [v for s in statuses for v in s.values if v.key == f"/{ready.group}/joint_trajectory"]

    assert int(ready.until(refused)[-1].value) == 1
