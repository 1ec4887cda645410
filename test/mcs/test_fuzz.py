"""Random messages on every service, action and topic of ``/mcs``: all answered, nothing moves, the node lives on."""

import math
import random
import re

import numpy as np
import pytest
from control_msgs.action import FollowJointTrajectory, GripperCommand, ParallelGripperCommand
from control_msgs.msg import JointJog
from controller_manager_msgs.srv import SwitchController
from geometry_msgs.msg import TwistStamped
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from im_core.ros.messages.interfaces import interface_class
from im_msgs.action import Move
from im_msgs.msg import SetpointCommand, TorqueCommand
from im_msgs.srv import (
    CheckPath,
    ForwardKinematics,
    GetGroupState,
    GroupCommand,
    InverseKinematics,
    RenewLease,
    ReserveGroup,
    SetController,
    SetGripper,
    SetPartition,
    SetPayload,
    SetSpeed,
)

# No value is one that a joint, a pose or a gripper could be sent to.
FLOATS = (math.nan, math.inf, -math.inf, -1e308, 1e308, -7.0)
TEXTS = ("", "left", "right", "transporter", "left_j1", "left_gripper", "ä\U0001f916", "x" * 300, "2x9", "../..")
SERVICES = {
    "release": ReserveGroup,
    "reserve": ReserveGroup,
    "renew": RenewLease,
    "set_partition": SetPartition,
    "pause": GroupCommand,
    "group/power_on": GroupCommand,
    "group/disable_motion": GroupCommand,
    "set_speed": SetSpeed,
    "set_payload": SetPayload,
    "set_controller": SetController,
    "set_gripper": SetGripper,
    "get_group_state": GetGroupState,
    "forward_kinematics": ForwardKinematics,
    "inverse_kinematics": InverseKinematics,
    "check_path": CheckPath,
    "/controller_manager/switch_controller": SwitchController,
}


def scrambled(message, rng):
    """The message with random values in every field."""
    for name, kind in message.get_fields_and_field_types().items():
        sequence = re.fullmatch(r"sequence<(.+)>", kind)
        if sequence:
            items = [value_of(sequence[1], rng) for _ in range(rng.choice((0, 1, 2, 8, 9, 10)))]
            setattr(message, name, items)
        else:
            setattr(message, name, value_of(kind, rng))
    return message


def value_of(kind, rng):
    """A random value of a type of ROS."""
    if kind in ("double", "float"):
        return rng.choice(FLOATS)
    if kind == "string":
        return rng.choice(TEXTS)
    if kind == "boolean":
        return rng.random() < 0.5
    if re.fullmatch(r"u?int\d+", kind):
        return rng.choice((0, 1, 2, 3, 100))
    return scrambled(interface_class(kind.replace("/", "/msg/"))(), rng)


@pytest.fixture
def still(ready):
    """A user at home; the arm has to be there at the end, too, and do as it is told.

    It sinks by 5 mrad where an emergency stop takes its power: its brakes hold after 0.08 s.
    """
    before = ready.group_state().q_rest
    yield ready
    ready.to_cold()
    ready.to_motion()
    np.testing.assert_allclose(ready.group_state().q_rest, before, atol=1e-2)
    result = ready.move(ready.home + 0.05)
    assert result.success, result.status.message


def test_services(still):
    rng = random.Random(0)
    for name, service_type in SERVICES.items():
        for _ in range(8):
            request = scrambled(service_type.Request(), rng)
            still.call(service_type, name, **{f: getattr(request, f) for f in request.get_fields_and_field_types()})


def test_actions(still):
    rng = random.Random(1)
    for action_type, name in (
        (Move, "/left/move"),
        (Move, "/transporter/move"),
        (FollowJointTrajectory, "/left/follow_joint_trajectory"),
        (GripperCommand, "/left_gripper/gripper_cmd"),
        (ParallelGripperCommand, "/left_gripper/parallel_gripper_action_controller/gripper_cmd"),
    ):
        pending = [still.act(action_type, name, scrambled(action_type.Goal(), rng))[1] for _ in range(12)]
        for result in pending:
            assert result().status == 6  # aborted


def test_topics(still):
    rng = random.Random(2)
    for message_type, topic in (
        (JointTrajectory, "/left/joint_trajectory"),
        (SetpointCommand, "/left/command/setpoints"),
        (TorqueCommand, "/left/command/torques"),
        (JointJog, "/left/delta_joint_cmds"),
        (TwistStamped, "/left/delta_twist_cmds"),
        (Float64MultiArray, "/left/forward_position_controller/commands"),
        (Float64MultiArray, "/left/forward_velocity_controller/commands"),
        (Float64MultiArray, "/left/forward_effort_controller/commands"),
    ):
        publisher = still.talk(message_type, topic)
        for _ in range(30):
            publisher.publish(scrambled(message_type(), rng))
    assert still.group_state().joints  # heard after all of them
