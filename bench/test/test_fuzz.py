"""What the fuzzer throws and what it does not: an order is no fuzz, whichever way it may be given."""

import pytest
from control_msgs.action import FollowJointTrajectory
from rcl_interfaces.srv import GetParameters
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from bench.fuzz.targets import Target, is_order


@pytest.mark.parametrize(("points", "order"), [([], True), ([JointTrajectoryPoint()], False)])
def test_an_empty_trajectory_is_an_order_to_stop(points, order):
    target = Target("topic", "/left/joint_trajectory", JointTrajectory)
    assert is_order(target, JointTrajectory(joint_names=["no joint"], points=points)) == order


def test_what_is_taken_is_what_is_sent():
    assert Target("topic", "/t", JointTrajectory).taken is JointTrajectory
    assert Target("service", "/s", GetParameters).taken is GetParameters.Request
    assert Target("action", "/a", FollowJointTrajectory).taken is FollowJointTrajectory.Goal
