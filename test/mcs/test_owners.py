"""Whose a group is: several clients, each a participant of DDS as a process is, at one ``/mcs``."""

import contextlib

import pytest
import rclpy
from control_msgs.action import FollowJointTrajectory
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Inertia
from rclpy.context import Context
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_core.ros import callers
from im_core.ros.run import spin_in_thread
from im_msgs.srv import GroupCommand, ReserveGroup, SetController, SetPayload, SetSpeed

LAW = "im_mcs.control.pid_gravity:PidGravity"


@pytest.fixture
def newcomer(client):
    """``newcomer(name)``: another process, in the eyes of DDS, with one node; the user that it is."""
    with contextlib.ExitStack() as stack:
        yield lambda name: stack.enter_context(_participant(client, name))


@contextlib.contextmanager
def _participant(client, name):
    context = Context()
    rclpy.init(context=context)
    try:
        node = rclpy.create_node(name, context=context)
        with spin_in_thread(node):
            yield type(client)(node, client.mcs)
    finally:
        context.try_shutdown()


def trajectory(client, step=0.02):
    """From where the left arm is, and back a little."""
    q = client.group_state().q_rest
    points = [JointTrajectoryPoint(positions=[x + step for x in q])]
    points[0].time_from_start.sec = 2
    return JointTrajectory(joint_names=client.joints, points=points)


def follow(user):
    """The answer to a trajectory of a user."""
    answer = user.follow(FollowJointTrajectory.Goal(trajectory=trajectory(user)))[1]().result
    return answer.error_code, answer.error_string


def refused_on(client, topic, diagnostics):
    values = [v for m in diagnostics for s in m.status for v in s.values if v.key == topic]
    return int(values[-1].value) if values else 0


def test_strangers_are_refused_and_the_owner_is_served(client, newcomer):
    client.to_motion(owner="ann")
    stranger, sentence = newcomer("eve"), "group 'left' is driven by its owner 'ann' only, not by '/eve'"
    before = client.group_state().q_rest
    assert sentence in stranger.move(client.home + 0.1).status.message
    assert sentence in follow(stranger)[1]
    for service_type, name, fields in (
        (SetSpeed, "set_speed", {"group": "left", "scale": 0.5}),
        (SetController, "set_controller", {"group": "left", "controller": LAW}),
        (SetPayload, "set_payload", {"group": "left", "payload": Inertia(m=0.5)}),
        (GroupCommand, "resume", {"group": "left"}),
        (GroupCommand, "resume", {}),
    ):
        answer = stranger.call(service_type, name, **fields)
        assert (answer.success, sentence in answer.message) == (False, True), (name, answer.message)
    assert client.group_state().q_rest == before
    assert client.status().owner == "ann"

    assert follow(client) == (0, "")
    assert client.call(SetSpeed, "set_speed", group="left", scale=0.5).success
    assert client.call(SetController, "set_controller", group="left", controller=LAW).success
    assert client.call(SetPayload, "set_payload", group="left", payload=Inertia(m=0.5)).success
    assert client.call(SetPayload, "set_payload", group="left").success
    assert client.call(SetSpeed, "set_speed", group="left", scale=1.0).success
    assert stranger.call(GroupCommand, "pause", group="left").success  # to stop is always allowed
    assert client.call(GroupCommand, "resume", group="left").success
    assert client.trigger("disable_motion").success
    assert client.trigger("power_off").success
    for owner, names in (("", "'/eve'"), ("eva", "'eva', '/eve'")):
        answer = stranger.call(ReserveGroup, "release", group="left", owner=owner)
        assert f"its owner 'ann' only, not by {names}" in answer.message
    assert client.call(ReserveGroup, "release", group="left").success


def test_nobody_knows_who_speaks_on_a_topic_of_trajectories(client):
    """It has neither an owner nor, in rclpy, a sender: with an owner it is not followed, without one it is."""
    diagnostics, topic = client.listen(DiagnosticArray, "/diagnostics"), "/left/joint_trajectory"
    publisher = client.talk(JointTrajectory, topic)
    client.to_motion(owner="ann")
    before, counted = client.group_state().q_rest, refused_on(client, topic, diagnostics)
    publisher.publish(trajectory(client))
    client.until(lambda: refused_on(client, topic, diagnostics) == counted + 1)
    assert client.group_state().q_rest == before
    assert client.call(ReserveGroup, "take_over", group="left").success
    publisher.publish(trajectory(client))
    client.until(lambda: client.group_state().q[3] > before[3] + 0.01)


def test_a_command_line_reserves_for_a_node_which_moves(client, newcomer):
    """As with MoveIt: ``ros2 service call`` is a process that ends, ``move_group`` sends the trajectories."""
    with _participant(client, "_ros2cli_77") as shell:
        assert shell.call(ReserveGroup, "reserve", group="left", owner="move_group").success
    assert client.trigger("power_on").success
    assert client.trigger("enable_motion").success
    move_group = newcomer("move_group")
    assert "its owner 'move_group' only, not by '/listener'" in follow(client)[1]
    assert follow(move_group) == (0, "")
    assert move_group.call(SetSpeed, "set_speed", group="left", scale=1.0).success


def test_an_operator_takes_over_which_is_logged_and_shown(client, newcomer):
    client.to_motion(owner="ann")
    operator, diagnostics = newcomer("panel"), client.listen(DiagnosticArray, "/diagnostics")
    assert not client.call(ReserveGroup, "take_over", group="right").success
    _, result = client.start_far_move()
    answer = operator.call(ReserveGroup, "take_over", group="left", owner="panel")
    assert answer.message == "group 'left', until now of 'ann', is taken over for 'panel' by /panel"
    assert "group 'left' was taken over for 'panel'" in result().status.message
    assert "its owner 'panel' only" in client.move(client.home).status.message
    client.until(lambda: any(v.value == answer.message for m in diagnostics for s in m.status for v in s.values))
    client.until(lambda: client.status().owner == "panel")
    assert operator.move(client.home).success
    assert operator.call(ReserveGroup, "take_over", group="left", owner="ann").success
    assert client.call(ReserveGroup, "release", group="left", owner="ann").message.startswith("release is refused in")


def test_a_process_is_known_by_the_header_of_its_request(client, newcomer):
    seen = []
    service = client.mcs.create_service(ReserveGroup, "/who", lambda *_: lambda caller: _answered(seen, caller))
    one, two = newcomer("one"), newcomer("two")
    for user in (one, two, one):
        asked = user.node.create_client(ReserveGroup, "/who")
        assert asked.wait_for_service(5.0)
        assert asked.call(ReserveGroup.Request(), timeout_sec=5.0).success
    client.mcs.destroy_service(service)
    assert seen[0] == seen[2] != seen[1]
    assert callers.nodes_of(client.node, seen[0]) == ("/one",)
    assert callers.nodes_of(client.node, seen[1]) == ("/two",)
    assert callers.nodes_of(client.node, "") == ()
    with pytest.raises(TypeError, match="a str is not the header of a request"):
        callers.client_of("header")


async def _answered(seen, caller):
    seen.append(caller)
    return ReserveGroup.Response(success=True)
