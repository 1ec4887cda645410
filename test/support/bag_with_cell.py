"""A bag of a mission, with a cell that turns one joint and takes one image."""

from geometry_msgs.msg import Point, PointStamped, TransformStamped
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Header, String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from im_bag import BagReader, BagWriter, Delivery
from im_cell.robot import load_cell, urdf

JOINT = "left_j1"
SIZE = (4, 3)
HALF = 300
"""Firing with which the image is taken; there must be more."""
EACH = Delivery(reliable=True, latched=False, depth=10)
KINDS = {
    "/robot_description": "std_msgs/msg/String",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/markers": "visualization_msgs/msg/MarkerArray",
    "/wall/image_raw": "sensor_msgs/msg/Image",
    "/wall/spot": "geometry_msgs/msg/PointStamped",
}


def write_bag_with_cell(mission, path):
    """Copy a mission, and add a cell: at each firing the joint has turned by a thousandth.

    Returns:
        The number of firings.
    """
    firings = 0
    with BagReader(mission) as bag:
        out = BagWriter(path)
        for topic, kind in bag.types.items():
            out.add_topic(topic, kind, bag.deliveries[topic], bag.hashes[topic])
        for topic, kind in KINDS.items():
            out.add_topic(topic, kind, EACH)
        begun = False
        for topic, stamp_ns, data in bag.messages(bag.types):
            if not begun:
                begun = True
                _write_scene(out, stamp_ns)
            out.write(topic, stamp_ns, data)
            if topic == "/pnt/firings":
                firings += 1
                joints = JointState(name=[JOINT], position=[firings / 1000.0], velocity=[0.0], effort=[0.0])
                out.write("/joint_states", stamp_ns, serialize_message(joints))
                if firings == HALF:
                    width, height = SIZE
                    image = Image(width=width, height=height, step=width, encoding="mono8", data=bytes(width * height))
                    spot = PointStamped(point=Point(x=1.0, y=2.0))
                    out.write("/wall/image_raw", stamp_ns, serialize_message(image))
                    out.write("/wall/spot", stamp_ns, serialize_message(spot))
        out.close()
    return firings


def _write_scene(out, stamp_ns):
    frame = TransformStamped(header=Header(frame_id="world"), child_frame_id="wall")
    frame.transform.translation.z = 2.0
    frame.transform.rotation.w = 1.0
    light = Marker(ns="lights", id=0, type=Marker.SPHERE, action=Marker.ADD, header=Header(frame_id="left_led"))
    odd = Marker(ns="odd", id=1, type=Marker.CUBE, action=Marker.ADD)
    odd.scale.x = float("nan")
    scene = {
        "/robot_description": String(data=urdf(load_cell())),
        "/tf_static": TFMessage(transforms=[frame]),
        "/markers": MarkerArray(markers=[light, odd]),
    }
    for topic, message in scene.items():
        out.write(topic, stamp_ns, serialize_message(message))
