"""Where the light is, by ``/tf``: whatever others send there, the pose that MCS has told stands."""

import math
import threading
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
from rclpy.serialization import serialize_message
from tf2_msgs.msg import TFMessage

from im_cell.robot import load_cell
from im_vss.ros.light_tracker import LightTracker


def message(*frames, rotation=(0.0, 0.0, 0.0, 1.0), seconds=0):
    """Frames, each at (1, 2, 3) m in the next; the last is in the world unless it is there before."""
    told = TFMessage()
    for child, parent in pairwise(frames):
        step = TransformStamped(child_frame_id=child)
        step.header.frame_id = parent
        step.header.stamp.sec = seconds
        step.transform.translation = Vector3(x=1.0, y=2.0, z=3.0)
        step.transform.rotation = Quaternion(**dict(zip("xyzw", rotation, strict=True)))
        told.transforms.append(step)
    return serialize_message(told)


TRUE = message("left_link6", "left_base", "world")
NOISE = {
    "no message": b"\0\1\0\0" + b"\xff" * 40,
    "nothing": b"",
    "others' frames": message("camera", "world"),
    "no way to the world": message("left_link6", "left_base"),
    "a circle": message("left_link6", "left_base", "left_link6"),
    "itself": message("left_link6", "left_link6"),
    "no rotation": message("left_link6", "world", rotation=(0.0, 0.0, 0.0, 0.0)),
    "no number": message("left_link6", "world", rotation=(0.0, 0.0, 0.0, math.nan)),
}


@pytest.fixture
def tracker():
    heard = {}
    node = SimpleNamespace(create_subscription=lambda kind, topic, take, *_, **__: heard.update({topic: take}))
    tracker = LightTracker(node, load_cell(), "left_led", freshness_s=1.0, late_s=60.0)
    tracker.hear = heard["/tf"]
    return tracker


@pytest.mark.parametrize("noise", NOISE.values(), ids=NOISE)
def test_the_newest_pose_stands_whatever_others_send(tracker, noise):
    tracker.hear(noise)
    assert tracker.wrist("left_wrist", 0) is None
    tracker.hear(TRUE)
    rotation, origin = tracker.wrist("left_wrist", 0)
    for _ in range(20):
        tracker.hear(noise)
    np.testing.assert_array_equal(tracker.wrist("left_wrist", 0)[0], rotation)
    np.testing.assert_array_equal(tracker.wrist("left_wrist", 0)[1], origin)
    tracker.hear(message("left_link6", "world"))
    np.testing.assert_allclose(origin - tracker.wrist("left_wrist", 0)[1], [1.0, 2.0, 3.0])


def test_a_pose_of_another_time_is_none(tracker):
    tracker.hear(TRUE)
    assert tracker.wrist("left_wrist", 1_000_000_000) is not None
    tracker.hear(message("left_link6", "left_base", "world", seconds=9))
    assert tracker.wrist("left_wrist", 1_000_000_001) is None


def test_a_pose_on_its_way_to_a_busy_node_is_awaited(tracker):
    tracker.hear(TRUE)
    tracker.hear(NOISE["others' frames"])
    come = threading.Timer(0.1, lambda: tracker.hear(message("left_link6", "left_base", "world", seconds=5)))
    come.start()
    assert tracker.wrist("left_wrist", 5_000_000_000) is not None
    come.join()


def test_a_pose_of_a_time_that_has_passed_is_not_awaited(tracker):
    tracker.hear(TRUE)
    tracker.hear(message("left_link6", "left_base", "world", seconds=9))
    assert tracker.wrist("left_wrist", 5_000_000_000) is None
