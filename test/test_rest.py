"""A machine at rest rests: what is read once is not read by each, and what nobody needs often is not done often."""

import numpy as np
import pinocchio as pin
import pytest
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from tf2_msgs.msg import TFMessage

from im_cell.robot import load_cell
from im_core.ros.guard import GuardedNode
from im_core.ros.node import HEARTBEAT_PERIOD_S, STARTING_PERIOD_S, ManagedNode
from im_core.ros.rclpy_fixes.one_reader import shared_readers
from im_core.startup import STATUS_TOPIC
from im_mcs.model import CellModel
from im_mcs.ros.topics.publishers import Frames
from im_msgs.msg import TaskStatus

SIM_TIME = Parameter("use_sim_time", value=True)


def seconds(node):
    return node.get_clock().now().nanoseconds // 1_000_000_000


def test_nodes_of_a_process_read_the_clock_once_and_each_follows_it(ros, wait_until):
    with shared_readers():
        nodes = [ManagedNode(name, parameter_overrides=[SIM_TIME]) for name in ("oven", "scale")]
    alone = ManagedNode("alone", parameter_overrides=[SIM_TIME])
    teller = GuardedNode("teller")
    clock = teller.create_publisher(Clock, "/clock", 10)
    ros(*nodes, alone, teller)
    wait_until(lambda: clock.get_subscription_count() == 2, "two readers of /clock")

    def told(second):
        message = Clock()
        message.clock.sec = second
        clock.publish(message)
        return [seconds(node) for node in (*nodes, alone)] == [second] * 3

    wait_until(lambda: told(7), "all three at 7 s")
    nodes[0].set_parameters([Parameter("use_sim_time", value=False)])
    wait_until(lambda: told(9) or (seconds(nodes[1]), seconds(alone)) == (9, 9), "the others at 9 s")
    assert seconds(nodes[0]) > 1_000_000, "it has left testbed time; the others have not"
    nodes[0].set_parameters([SIM_TIME])
    wait_until(lambda: told(11), "all three at 11 s")


@pytest.mark.raises
def test_what_one_follower_raises_the_others_do_not_feel(ros, wait_until):
    heard = []
    with shared_readers():
        first, second = GuardedNode("first"), GuardedNode("second")

        def burn(_):
            raise ValueError("burnt")

        first.create_subscription(TaskStatus, STATUS_TOPIC, burn, 10)
        second.create_subscription(TaskStatus, STATUS_TOPIC, lambda message: heard.append(message.name), 10)
    other = first.create_publisher(TaskStatus, STATUS_TOPIC, 10)
    ros(first, second)
    assert other.get_subscription_count() == 1

    def told():
        other.publish(TaskStatus(name="oven"))
        return heard

    wait_until(told, "the second follower")
    assert heard[0] == "oven"


def test_a_task_that_is_ready_wakes_once_a_second(ros, wait_until):
    node = ManagedNode("oven", parameter_overrides=[Parameter("standalone", value=True)])
    periods = [timer.timer_period_ns for timer in node.timers if not timer.is_canceled()]
    assert STARTING_PERIOD_S * 1e9 in periods, "who starts tells often how far it is"
    ros(node)
    wait_until(lambda: node.ready, "the node to be ready")
    wait_until(lambda: sum(not timer.is_canceled() for timer in node.timers) == 1, "the last alarm")
    (period,) = [timer.timer_period_ns for timer in node.timers if not timer.is_canceled()]
    assert period == HEARTBEAT_PERIOD_S * 1e9 == 1e9


def test_transforms_travel_as_the_bytes_of_their_message():
    cell = load_cell()
    model = CellModel(cell)
    frames = Frames(cell, model)
    for q, stamp_ns in ((cell.home, 4_500_000), (cell.home + 0.1, 7_000_000_123)):
        message = deserialize_message(frames.moving(np.asarray(q), stamp_ns), TFMessage)
        assert [(t.header.frame_id, t.child_frame_id) for t in message.transforms] == [
            (joint.parent, joint.child) for joint in cell.joints
        ]
        for told, placement in zip(message.transforms, model.over_joints(np.asarray(q)), strict=True):
            assert told.header.stamp.sec * 1_000_000_000 + told.header.stamp.nanosec == stamp_ns
            turn, shift = told.transform.rotation, told.transform.translation
            values = [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z, turn.w]
            np.testing.assert_array_equal(values, pin.SE3ToXYZQUAT(placement))
