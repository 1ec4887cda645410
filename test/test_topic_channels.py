"""The process that speaks ROS for a driver: what reaches the robot."""

import os

import pytest
from sensor_msgs.msg import JointState

from im_core import clock
from im_core.ros import qos
from im_core.ros.guard import GuardedNode
from im_mcs.ros.topic_channels import TopicChannels
from im_mcs.testbed.joint_state import TopicLink

NAME = f"imchannels{os.getpid()}"


@pytest.fixture
def link(ros):
    """The driver's end; ``link.heard``: the efforts that the robot was given."""
    link, robot = TopicLink.create(NAME, TopicLink.layout(2)), GuardedNode("robot")
    channels = TopicChannels(NAME, ["x", "y"], "/robot/state", "/robot/command", 10.0)
    link.heard = []
    robot.create_subscription(JointState, "/robot/command", lambda told: link.heard.extend(told.effort), qos.SENSOR)
    ros(channels, robot)
    yield link
    channels.stop()
    link.close()


def drive(link, effort):
    command = link.command.record()
    command["effort"], command["driven"], command["at"] = [effort, 0.0], [True, False], clock.monotonic()
    link.command.write(command)
    link.bell.post()


def test_a_driver_that_stood_still_in_the_middle_of_a_command_is_heard_afterwards(link, wait_until):
    wait_until(lambda: drive(link, 1.0) or 1.0 in link.heard, "an effort")
    link.command._sequence[()] |= 1  # as a process that is stopped there leaves it
    link.bell.post()
    clock.sleep(1.0)  # longer than a reader waits for the end of a write
    wait_until(lambda: drive(link, 2.0) or 2.0 in link.heard, "the next one")
