"""The process that speaks ROS for a driver: what reaches the robot, and what of the robot reaches the driver."""

import os

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray

from im_core import clock
from im_core.ros import qos
from im_core.ros.guard import GuardedNode
from im_mcs.ros.topic_channels import TopicChannels
from im_mcs.testbed.joint_state import TopicLink

NAME = f"imchannels{os.getpid()}"
JOINTS = ["x", "y"]


class Robot:
    """Both ends of the process: the driver's memory, and the robot's topics.

    Attributes:
        heard: Commands that the robot was given, each by joint.
    """

    def __init__(self, ros, kind="effort", order=None, faults=(), kinds=None):
        self.link, self.node = TopicLink.create(NAME, TopicLink.layout(2)), GuardedNode("robot")
        self.kind, self.order, self.heard = kind, order, []
        self.channels = TopicChannels(
            NAME, JOINTS, kinds or [kind] * 2, "/robot/state", "/robot/command", 10.0, faults=faults, order=order
        )
        self.publisher = self.node.create_publisher(JointState, "/robot/state", 10)
        message_type = JointState if order is None else Float64MultiArray
        self.node.create_subscription(message_type, "/robot/command", self._take, 10)  # reliable, as usual
        ros(self.channels, self.node)

    def _take(self, told):
        values = (
            zip(self.order, told.data, strict=True)
            if self.order
            else zip(told.name, getattr(told, self.kind), strict=False)
        )
        self.heard.append(dict(values))

    def drive(self, value, driven=(True, False)):
        command = self.link.command.record()
        command["value"], command["driven"], command["at"] = value, driven, clock.monotonic()
        self.link.command.write(command)
        self.link.bell.post()

    def tell(self, *q):
        self.publisher.publish(JointState(name=JOINTS, position=[float(value) for value in q]))

    def received(self):
        return self.link.received.read()


@pytest.fixture
def robot(ros):
    made = []

    def make(**options):
        made.append(Robot(ros, **options))
        return made[-1]

    yield make
    for each in made:
        each.channels.stop()
        each.link.close()


def test_a_driver_that_stood_still_in_the_middle_of_a_command_is_heard_afterwards(robot, wait_until):
    robot = robot()
    wait_until(lambda: robot.drive([1.0, 0.0]) or {"x": 1.0} in robot.heard, "an effort")
    robot.link.command._sequence[()] |= 1  # as a process that is stopped there leaves it
    robot.link.bell.post()
    clock.sleep(1.0)  # longer than a reader waits for the end of a write
    wait_until(lambda: robot.drive([2.0, 0.0]) or {"x": 2.0} in robot.heard, "the next one")


def test_a_joint_that_is_driven_no_more_is_told_to_stand_where_it_was_then_left_alone(robot, wait_until):
    robot = robot(kind="position")
    wait_until(lambda: robot.tell(0.1, 0.2) or robot.received()["at"].all(), "the robot to be heard")
    wait_until(lambda: robot.drive([0.5, 0.0]) or {"x": 0.5} in robot.heard, "a position")
    assert all(set(each) == {"x"} for each in robot.heard)
    wait_until(lambda: robot.tell(0.3, 0.2) or robot.received()["q"][0] == 0.3, "the place where it is")
    wait_until(lambda: robot.drive([np.nan, np.nan], (False, False)) or {"x": 0.3} in robot.heard, "the place to stand")
    robot.tell(0.25, 0.2)  # what it does then is its own affair: the place stays
    count = -1
    while count != len(robot.heard):
        count = len(robot.heard)
        robot.drive([0.7, 0.0], (False, False))
        clock.sleep(0.7)
    assert robot.heard[-1] == {"x": 0.3}


def test_a_joint_that_is_driven_no_more_is_told_to_stand_where_mcs_says(robot, wait_until):
    """A reading that has leapt is no place to go to."""
    robot = robot(kind="position")
    wait_until(lambda: robot.tell(0.1, 0.2) or robot.received()["at"].all(), "the robot to be heard")
    wait_until(lambda: robot.drive([0.1, np.nan]) or {"x": 0.1} in robot.heard, "a position")
    wait_until(lambda: robot.tell(30.0, 0.2) or robot.received()["q"][0] == 30.0, "a reading that has leapt")
    for _ in range(20):
        robot.drive([0.11, np.nan], (False, False))
        clock.sleep(0.02)
    wait_until(lambda: {"x": 0.11} in robot.heard, "the place to stand")
    assert {"x": 30.0} not in robot.heard


def test_a_velocity_ends_with_zero_also_when_its_driver_hangs(robot, wait_until):
    robot = robot(kind="velocity")
    robot.channels._silence_s = 0.3
    wait_until(lambda: robot.drive([0.5, 0.0]) or {"x": 0.5} in robot.heard, "a velocity")
    wait_until(lambda: robot.heard[-1] == {"x": 0.0}, "velocity 0")  # nobody rings the bell any more


def test_a_controller_is_told_all_of_its_joints_in_its_own_order(robot, wait_until):
    robot = robot(kind="position", order=["y", "x"])
    wait_until(lambda: robot.tell(0.1, 0.2) or robot.received()["at"].all(), "the robot to be heard")
    wait_until(lambda: robot.drive([0.5, np.nan]) or {"y": 0.2, "x": 0.5} in robot.heard, "positions")
    robot.drive([np.nan, np.nan])
    wait_until(lambda: robot.drive([0.6, np.nan]) or {"y": 0.2, "x": 0.6} in robot.heard, "the next ones")
    assert all(np.isfinite(list(each.values())).all() and len(each) == 2 for each in robot.heard)


def test_a_controller_without_a_place_to_stand_is_told_nothing(robot, wait_until):
    robot = robot(kind="position", order=JOINTS)
    for _ in range(20):
        robot.drive([0.5, np.nan])  # of y nothing has been heard
        clock.sleep(0.02)
    assert robot.heard == []
    wait_until(lambda: robot.tell(0.1, 0.2) or robot.drive([0.5, np.nan]) or robot.heard, "positions")
    assert robot.heard[0] == {"x": 0.5, "y": 0.2}


def test_fault_topics_say_what_is_wrong_until_it_is_not(robot, wait_until):
    watched = [{"topic": "/robot/estop"}, {"topic": "/diagnostics", "status": "arm", "silence_s": 1.0}]
    robot = robot(faults=watched)

    def faults():
        return bytes(robot.received()["faults"]).rstrip(b"\0").decode()

    wait_until(
        lambda: faults() == "nothing was heard of /robot/estop data; nothing was heard of /diagnostics arm", "it"
    )
    stop = robot.node.create_publisher(Bool, "/robot/estop", qos.LATCHED)
    health = robot.node.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def say(level, message=""):
        others = DiagnosticStatus(level=DiagnosticStatus.ERROR, name="camera", message="cold")
        return DiagnosticArray(status=[DiagnosticStatus(level=level, name="arm: safety", message=message), others])

    stop.publish(Bool(data=False))
    wait_until(lambda: health.publish(say(DiagnosticStatus.WARN)) or faults() == "", "no fault")
    stop.publish(Bool(data=True))
    wait_until(lambda: health.publish(say(DiagnosticStatus.OK)) or faults() == "/robot/estop data is True", "the fault")
    told = "/robot/estop data is True; /diagnostics arm: safety: protective stop"
    wait_until(
        lambda: health.publish(say(DiagnosticStatus.ERROR, "protective stop")) or faults() == told, "the second one"
    )
    stop.publish(Bool(data=False))
    wait_until(lambda: health.publish(say(DiagnosticStatus.OK)) or faults() == "", "no fault")
    wait_until(lambda: faults() == "nothing was heard of /diagnostics arm for 1 s", "its silence")
    wait_until(lambda: health.publish(say(DiagnosticStatus.OK)) or faults() == "", "no fault again")


def test_commands_of_two_kinds_are_two_messages(robot, wait_until):
    robot = robot(kinds=["effort", "velocity"], kind="velocity")
    efforts = []
    robot.node.create_subscription(
        JointState, "/robot/command", lambda told: efforts.append((list(told.name), list(told.effort))), 10
    )
    both = (True, True)
    wait_until(lambda: robot.drive([4.0, 0.5], both) or {"y": 0.5} in robot.heard, "a velocity")
    wait_until(lambda: robot.drive([4.0, 0.5], both) or (["x"], [4.0]) in efforts, "an effort")
    wait_until(lambda: robot.drive([4.0, 0.5], (False, False)) or robot.heard[-1] == {"y": 0.0}, "velocity 0")
    assert (["x"], [0.0]) not in efforts
