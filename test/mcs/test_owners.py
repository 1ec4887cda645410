"""Whose a group is, and what it is in: several clients, each a participant of DDS as a process is, at one ``/mcs``."""

import contextlib

import pytest
import rclpy
from control_msgs.action import FollowJointTrajectory, GripperCommand, ParallelGripperCommand
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Inertia
from rclpy.context import Context
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_cell.robot import load_cell
from im_core.ros.guard import GuardedNode
from im_core.ros.peers import client_identity
from im_core.ros.run import spin_in_thread
from im_msgs.srv import GroupCommand, ReserveGroup, SetController, SetGripper, SetPayload, SetSpeed

RIGHT = load_cell().home[9:]
FAR = [RIGHT - [0.5, *[0.0] * 8], RIGHT] * 3
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
        node = GuardedNode(name, context=context)
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
    jaws = {"gripper": "left_gripper", "close": False}
    assert sentence in stranger.call(SetGripper, "set_gripper", **jaws).message
    grip = GripperCommand.Goal()
    assert not stranger.act(GripperCommand, "/left_gripper/gripper_cmd", grip)[1]().result.reached_goal
    grip = ParallelGripperCommand.Goal(command=JointState(position=[0.0]))
    name = "/left_gripper/parallel_gripper_action_controller/gripper_cmd"
    assert not stranger.act(ParallelGripperCommand, name, grip)[1]().result.reached_goal
    assert client.call(SetGripper, "set_gripper", **jaws).success
    assert newcomer("gripper_coordinator").call(SetGripper, "set_gripper", **jaws).success
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
    assert "group 'left' is driven by its owner 'move_group' only" in client.trigger("power_on").message
    for name in ("power_on", "enable_motion"):
        assert client.call(GroupCommand, f"group/{name}", group="left", owner="move_group").success
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
    assert client.call(ReserveGroup, "release", group="left", owner="ann").success  # motion and power go first
    client.until(lambda: (client.state(), client.states[-1].power) == ("cold", False))


def test_a_process_is_known_by_the_header_of_its_request(client, newcomer):
    seen = []
    service = client.mcs.create_service(ReserveGroup, "/who", lambda *_: lambda caller: _answered(seen, caller))
    one, two = newcomer("one"), newcomer("two")
    for user in (one, two, one):
        asked = user.node.create_client(ReserveGroup, "/who")
        assert asked.wait_for_service(60.0)
        assert asked.call(ReserveGroup.Request(), timeout_sec=60.0).success
    client.mcs.destroy_service(service)
    assert seen[0] == seen[2] != seen[1]
    assert client_identity.nodes_of(client.node, seen[0]) == ("/one",)
    assert client_identity.nodes_of(client.node, seen[1]) == ("/two",)
    assert client_identity.nodes_of(client.node, "") == ()
    with pytest.raises(TypeError, match="a str is not the header of a request"):
        client_identity.client_of("header")


async def _answered(seen, caller):
    seen.append(caller)
    return ReserveGroup.Response(success=True)


def states_of(client):
    """State and brakes of every group on ``/mcs/state``, once it has told them anew."""
    told = len(client.states)
    client.until(lambda: len(client.states) > told)
    return {status.group: (status.state, status.brakes) for status in client.states[-1].groups}


def test_one_moves_while_another_comes_and_goes(client, newcomer):
    ann, bob = newcomer("ann"), newcomer("bob")
    ann.to_motion("left", owner="ann")
    handle, result = ann.start_far_move(speed_scale=0.02)
    client.until(lambda: states_of(client) == {"left": ("motion", False), "right": ("cold", True)})
    assert bob.call(ReserveGroup, "reserve", group="right", owner="bob").success
    for name, state, brakes in (("power_on", "active", True), ("enable_motion", "motion", False)):
        answer = bob.trigger(name)
        assert answer.success, answer.message
        client.until(lambda: states_of(client) == {"left": ("motion", False), "right": (state, brakes)})  # noqa: B023
    moved = bob.move(RIGHT - 0.05 * (RIGHT > 1.0), group="right")
    assert moved.success, moved.status.message
    for name, said in (("disable_motion", "active"), ("power_off", "reserved")):
        answer = bob.call(GroupCommand, f"group/{name}", group="right")
        assert answer.success, answer.message
        client.until(lambda: states_of(client) == {"left": ("motion", False), "right": (said, True)})  # noqa: B023
    assert client.states[-1].state == "motion"
    assert client.states[-1].power
    assert client.lifecycle() == "active"
    assert bob.call(ReserveGroup, "release", group="right").success
    assert client.status().moving
    client.cancel(handle)
    assert result().status.code == "cancelled"


def test_nobody_takes_power_or_brakes_from_another_s_group(client, newcomer):
    """Seen: a second command's failure branch cut the power under a running calibration."""
    ann, bob = newcomer("ann"), newcomer("bob")
    ann.to_motion("left", owner="ann")
    _, result = ann.start_far_move()
    for name in ("disable_motion", "power_off"):
        answers = bob.trigger(name), bob.call(GroupCommand, f"group/{name}", group="left")
        assert not any(answer.success for answer in answers)
        assert "left" in answers[1].message
    assert not bob.change("deactivate")
    bob.to_motion("right", owner="bob")
    assert (
        "group 'left' is driven by its owner 'ann' only"
        in bob.call(GroupCommand, "group/disable_motion", group="left").message
    )
    for name in ("disable_motion", "power_off"):  # a Trigger is for what is the caller's
        assert bob.trigger(name).success
    client.until(lambda: states_of(client) == {"left": ("motion", False), "right": ("reserved", True)})
    assert result().success
    assert ann.trigger("disable_motion").success
    assert "group 'left' is driven by its owner 'ann' only" in newcomer("eve").trigger("power_off").message
    assert ann.trigger("power_off").success
    assert client.lifecycle() == "inactive"


def test_an_emergency_stop_is_of_all_groups(client, newcomer):
    users = {"left": newcomer("ann"), "right": newcomer("bob")}
    for group, user in users.items():
        user.to_motion(group, owner=user.node.get_name())
    _, first = users["left"].start_far_move(speed_scale=0.02)
    _, second = users["right"].start_move(*FAR, group="right", speed_scale=0.02)
    assert newcomer("eve").trigger("estop").success
    for result in (first, second):
        assert "emergency stop: request on /mcs/estop" in result().status.message
    client.until(lambda: states_of(client) == {"left": ("estopped", True), "right": ("estopped", True)})
    assert client.trigger("reset").success
    client.until(lambda: states_of(client) == {"left": ("cold", True), "right": ("cold", True)})


def test_a_client_that_dies_loses_its_own_group_alone(client, newcomer):
    ann = newcomer("ann")
    ann.to_motion("left", owner="ann")
    with _participant(client, "bob") as bob:
        bob.to_motion("right", owner="bob", lease=1.0)
        bob.start_move(*FAR, group="right", speed_scale=0.02)
    handle, of_ann = ann.start_far_move(speed_scale=0.02)
    client.until(lambda: client.status("right").lapsed and not client.status("right").moving)
    for name in ("disable_motion", "power_off"):
        answer = ann.call(GroupCommand, f"group/{name}", group="right")  # anybody may: its owner is given up on
        assert answer.success, answer.message
    client.until(lambda: client.status("right").state == "cold")
    assert client.status().moving
    client.cancel(handle)
    assert of_ann().status.code == "cancelled"


def test_one_call_makes_a_group_ready_for_anyone(client, newcomer):
    """As for MoveIt, whose trajectories come from another process than the call."""
    said = "group 'left' is in motion: it may move"
    assert client.trigger("left/ready").message == said
    assert follow(newcomer("move_group")) == (0, "")
    assert client.trigger("left/ready").message == said  # again: there is nothing left to do
    assert client.trigger("disable_motion").success
    assert client.trigger("left/ready").message == said  # the rest of the way
    client.until(lambda: (client.status().state, client.status().owner) == ("motion", ""))
    assert client.status("right").state == "cold"


def test_ready_says_the_first_refusal(client, newcomer):
    for group, sentence in (
        ("transporter", "group 'transporter' is not in the preset in force, 2x9 (left, right), but in 3x6"),
        ("testbed", "group 'testbed' is not in the preset in force"),
    ):
        answer = client.trigger(f"{group}/ready")
        assert (answer.success, sentence in answer.message) == (False, True), answer.message
    ann = newcomer("ann")
    assert ann.call(ReserveGroup, "reserve", group="left", owner="ann").success
    answer = client.trigger("left/ready")
    assert not answer.success
    assert "group 'left' is driven by its owner 'ann' only, not by '/listener'" in answer.message
    assert ann.trigger("left/ready").success
    assert client.trigger("left/ready").message == "group 'left' is in motion already, and its owner is 'ann'"
    client.trigger("estop")
    answer = ann.trigger("left/ready")
    assert not answer.success
    assert answer.message.startswith("reserve is refused in state estopped")
