"""Jogs and commands on topics as users of moveit_servo and of ros2_control's forwarding controllers send them."""

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from control_msgs.msg import JointJog, JointTrajectoryControllerState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TwistStamped, Vector3
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from std_msgs.msg import Float64MultiArray

from im_core.ros import qos
from im_msgs.action import Move
from im_msgs.srv import ReserveGroup

#: So long a velocity holds here, by testbed time, which runs as fast as it can: a stranger must come round meanwhile.
TIMEOUT_S = 5.0


@pytest.fixture(scope="module")
def patient(stranger):
    """The stranger, whose velocities hold for longer than usual."""
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=TIMEOUT_S)
    given = [Parameter(name="incoming_command_timeout", value=value)]
    assert stranger.call(SetParameters, "/mcs/set_parameters", parameters=given).results[0].successful
    return stranger


@pytest.fixture
def talk(ready, patient):
    """``talk(kind, topic, message)``: publish to the left group; its publishers end with the test."""
    publishers = {}

    def publish(topic, message):
        if topic not in publishers:
            publishers[topic] = patient.create_publisher(type(message), f"/left/{topic}", 10)
            ready.until(publishers[topic].get_subscription_count)
        publishers[topic].publish(message)

    yield publish
    for publisher in publishers.values():
        patient.destroy_publisher(publisher)


@pytest.fixture
def refused(ready):
    """``refused(topic)``: how many messages of a topic of the left group have been refused, as /diagnostics says."""
    told = ready.listen(DiagnosticArray, "/diagnostics")

    def count(topic):
        ready.until(lambda: told)
        values = [value for message in told for status in message.status for value in status.values]
        return max((int(value.value) for value in values if value.key == f"/left/{topic}"), default=0)

    return count


def joint_jog(names, velocities, stamp=None):
    message = JointJog(joint_names=names, velocities=velocities)
    message.header.stamp = stamp or Time()
    return message


def twist(frame, linear=(0.0, 0.0, 0.0), angular=(0.0, 0.0, 0.0)):
    message = TwistStamped()
    message.header.frame_id = frame
    message.twist.linear, message.twist.angular = (Vector3(x=v[0], y=v[1], z=v[2]) for v in (linear, angular))
    return message


def test_a_joint_jog_of_some_joints_moves_them_and_stops_by_itself(ready, talk, refused):
    before, refusals = ready.rest(), refused("delta_joint_cmds")
    for _ in range(3):
        talk("delta_joint_cmds", joint_jog(["left_j6", "left_j4"], [0.05, -0.02]))
    ready.until(lambda: ready.status().moving)
    ready.until(lambda: not ready.status().moving)
    moved = np.array(ready.rest()) - before
    assert moved[8] >= 0.05 * TIMEOUT_S * 0.9
    assert moved[6] == pytest.approx(-0.4 * moved[8], abs=1e-3)
    np.testing.assert_allclose(moved[[0, 1, 2, 3, 4, 5, 7]], 0.0, atol=1e-3)
    assert refused("delta_joint_cmds") == refusals  # silence is how a jog ends


def test_a_move_that_takes_over_from_a_jog_is_no_refusal(ready, talk, refused):
    refusals = refused("delta_joint_cmds")
    talk("delta_joint_cmds", joint_jog(["left_j6"], [0.05]))
    ready.until(lambda: ready.status().moving)
    assert ready.move(ready.home, policy=Move.Goal.REPLACE).success
    later = ready.listen(DiagnosticArray, "/diagnostics")
    ready.until(lambda: any(status.name.startswith("mcs") for message in later for status in message.status))
    assert refused("delta_joint_cmds") == refusals


def test_a_twist_moves_the_wrist_along_its_own_axis(ready, talk):
    pose = ready.group_state().wrist
    talk("delta_twist_cmds", twist("left_wrist", linear=(0.0, 0.0, -0.01)))
    ready.until(lambda: ready.status().moving)
    ready.until(lambda: not ready.status().moving)
    after = ready.group_state().wrist
    way = np.array([getattr(after.position, a) - getattr(pose.position, a) for a in "xyz"])
    o = pose.orientation
    axis = np.array([2 * (o.x * o.z + o.w * o.y), 2 * (o.y * o.z - o.w * o.x), 1 - 2 * (o.x**2 + o.y**2)])
    assert np.linalg.norm(way) == pytest.approx(0.01 * TIMEOUT_S, rel=0.2)
    np.testing.assert_allclose(way / np.linalg.norm(way), -axis, atol=0.03)


def test_the_status_says_why_a_jog_is_slowed_down(ready, patient, talk):
    told = []
    listening = patient.create_subscription(DiagnosticStatus, "/left/jog_status", told.append, qos.LATCHED)
    ready.until(lambda: told and told[-1].level == DiagnosticStatus.OK)
    talk("delta_joint_cmds", joint_jog(["left_j6"], [50.0]))
    ready.until(lambda: any(status.values[0].value == "7" for status in told))
    status = next(status for status in told if status.values[0].value == "7")
    assert status.message == "slowed down to the velocity limit of a joint"
    ready.until(lambda: told[-1].level == DiagnosticStatus.OK)
    patient.destroy_subscription(listening)


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        ("delta_joint_cmds", joint_jog(["left_j6"], [0.1, 0.1])),
        ("delta_joint_cmds", joint_jog(["right_j6"], [0.1])),
        ("delta_joint_cmds", joint_jog([], [])),
        ("delta_joint_cmds", joint_jog(["left_j6"], [math.nan])),
        ("delta_joint_cmds", joint_jog(["left_j6"], [0.1], Time(sec=1))),
        ("delta_joint_cmds", joint_jog(["left_j6"], [0.1], Time(sec=2_000_000_000))),
        ("delta_joint_cmds", JointJog(joint_names=["left_j6"], displacements=[0.1])),
        ("delta_twist_cmds", twist("", linear=(0.1, 0.0, 0.0))),
        ("delta_twist_cmds", twist("hat", linear=(0.1, 0.0, 0.0))),
        ("delta_twist_cmds", twist("world", angular=(0.1, 0.0, math.inf))),
        ("forward_position_controller/commands", Float64MultiArray(data=[0.1] * 8)),
        ("forward_position_controller/commands", Float64MultiArray(data=[9.0] * 9)),
        ("forward_velocity_controller/commands", Float64MultiArray(data=[0.1] * 8 + [math.nan])),
        ("forward_velocity_controller/commands", Float64MultiArray()),
        ("forward_effort_controller/commands", Float64MultiArray(data=[math.inf] + [0.0] * 8)),
        ("forward_effort_controller/commands", Float64MultiArray(data=[0.0] * 10)),
    ],
)
def test_what_is_no_command_is_counted_and_moves_nothing(ready, talk, refused, topic, message):
    before, refusals = ready.rest(), refused(topic)
    ready.until(lambda: ready.positions[-1].header.stamp.sec > 6)  # a stamp of 1 s is old
    talk(topic, message)
    ready.until(lambda: refused(topic) > refusals)
    assert not ready.status().moving
    np.testing.assert_allclose(ready.rest(), before, atol=1e-4)


def test_positions_are_gone_to_and_velocities_are_followed(ready, talk):
    there = np.array(ready.home) + 0.05
    talk("forward_position_controller/commands", Float64MultiArray(data=there.tolist()))
    ready.until(lambda: ready.status().moving)
    ready.until(lambda: not ready.status().moving)
    np.testing.assert_allclose(ready.rest(), there, atol=1e-3)
    velocities = np.zeros(9)
    velocities[8] = -0.05
    talk("forward_velocity_controller/commands", Float64MultiArray(data=velocities.tolist()))
    ready.until(lambda: ready.status().moving)
    ready.until(lambda: not ready.status().moving)
    assert there[8] - ready.rest()[8] >= 0.05 * TIMEOUT_S * 0.9


def test_efforts_drive_the_joints_until_they_stop_coming(ready, patient, talk, refused):
    outputs = []
    listening = patient.create_subscription(
        JointTrajectoryControllerState, "/left/controller_state", outputs.append, 10
    )
    ready.until(lambda: outputs)
    held = list(outputs[-1].output.effort)
    talk("forward_effort_controller/commands", Float64MultiArray(data=held))
    ready.until(lambda: np.array_equal(outputs[-1].output.effort, held))
    refusals = refused("delta_joint_cmds")
    talk("delta_joint_cmds", joint_jog(["left_j6"], [0.1]))  # one layer at a time
    ready.until(lambda: refused("delta_joint_cmds") > refusals)
    ready.until(lambda: not np.array_equal(outputs[-1].output.effort, held))  # the law has taken over
    patient.destroy_subscription(listening)
    ready.rest()


def test_a_group_with_an_owner_obeys_no_topic(ready, talk, refused):
    before = ready.rest()
    assert ready.call(ReserveGroup, "take_over", group="left", owner="listener").success
    for topic, message in (
        ("delta_joint_cmds", joint_jog(["left_j6"], [0.1])),
        ("delta_twist_cmds", twist("world", linear=(0.1, 0.0, 0.0))),
        ("forward_position_controller/commands", Float64MultiArray(data=list(ready.home))),
        ("forward_velocity_controller/commands", Float64MultiArray(data=[0.1] * 9)),
        ("forward_effort_controller/commands", Float64MultiArray(data=[0.0] * 9)),
    ):
        refusals = refused(topic)
        talk(topic, message)
        ready.until(lambda topic=topic, refusals=refusals: refused(topic) > refusals)
    np.testing.assert_allclose(ready.rest(), before, atol=1e-4)
    assert ready.call(ReserveGroup, "take_over", group="left").success
