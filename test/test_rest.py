"""A machine at rest rests: what is read once is not read by each, and what nobody needs often is not done often."""

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from tf2_msgs.msg import TFMessage

from im_cell.robot import load_cell, robot_description
from im_core.processes.startup import STATUS_TOPIC
from im_core.ros.guard import GuardedNode
from im_core.ros.node import HEARTBEAT_PERIOD_S, STARTING_PERIOD_S, ManagedNode
from im_core.ros.rclpy_fixes.one_reader import shared_readers
from im_mcs.model import CellModel
from im_mcs.ros.topics.publishers import Frames, JawSpeeds
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


def place_by(transforms, link):
    """Pose of a link in the world by transforms, by child, shape (4, 4)."""
    pose = np.eye(4)
    while link != "world":
        step = transforms[link]
        turn, shift = step.transform.rotation, step.transform.translation
        values = np.array([shift.x, shift.y, shift.z, turn.x, turn.y, turn.z, turn.w])
        pose, link = pin.XYZQUATToSE3(values).homogeneous @ pose, step.header.frame_id
    return pose


def test_transforms_travel_as_the_bytes_of_their_message_and_lead_to_every_link():
    cell = load_cell()
    model, names = CellModel(cell), (*cell.joint_names, "left_gripper", "right_gripper")
    description = robot_description(cell, {joint.name: joint.limits for joint in cell.joints})
    links = {link.get("name") for link in ET.fromstring(description).iterfind("link")}
    frames = Frames(description, names)
    fixed = {told.child_frame_id: told for told in frames.fixed()}
    for q, openings, stamp_ns in ((cell.home, (0.08, 0.0), 4_500_000), (cell.home + 0.1, (0.01, 0.05), 7_000_000_123)):
        message = deserialize_message(frames.moving(np.array([*q, *openings]), stamp_ns), TFMessage)
        for told in message.transforms:
            assert told.header.stamp.sec * 1_000_000_000 + told.header.stamp.nanosec == stamp_ns
        transforms = fixed | {told.child_frame_id: told for told in message.transforms}
        assert len(transforms) == len(fixed) + len(message.transforms)
        assert transforms.keys() | {"world"} == links
        for name, pose in model.poses(q).items():
            np.testing.assert_allclose(place_by(transforms, name), pose.homogeneous, atol=1e-12)
        for side, opening in zip(cell.groups, openings, strict=True):
            wrist = np.linalg.inv(place_by(transforms, f"{side}_wrist"))
            for jaw, x in ((1, -opening / 2), (2, opening / 2)):
                place = (wrist @ place_by(transforms, f"{side}_jaw_{jaw}"))[:3, 3]
                np.testing.assert_allclose(place, [x, 0.0, cell.gripper.reach], atol=1e-12)
        for name, camera in cell.cameras.items():
            body = np.linalg.inv(place_by(transforms, camera.parent)) @ place_by(transforms, f"{name}_body")
            np.testing.assert_allclose(body[:3, :3].T, camera.pose()[0], atol=1e-12)


def test_a_robot_without_grippers_says_nothing_of_their_jaws():
    cell = load_cell()
    description = robot_description(cell, {joint.name: joint.limits for joint in cell.joints})
    message = deserialize_message(Frames(description, cell.joint_names).moving(cell.home, 0), TFMessage)
    assert [told.child_frame_id for told in message.transforms] == [joint.child for joint in cell.joints]


def test_speeds_of_jaws_are_differences_of_their_openings():
    speeds = JawSpeeds(2)
    for stamp_ns, openings, expected in (
        (20_000_000, [0.08, 0.08], [0.0, 0.0]),  # nobody knows what was before
        (40_000_000, [0.075, 0.08], [-0.25, 0.0]),
        (40_000_000, [0.075, 0.08], [-0.25, 0.0]),  # the same sample again, as where time stands still
        (50_000_000, [0.075, 0.079], [0.0, -0.1]),
        (20_000_000, [0.08, 0.08], [0.0, 0.0]),  # the testbed was started anew
    ):
        assert speeds.take_sample({"stamp_ns": stamp_ns, "gripper": openings}) == pytest.approx(expected)
