"""Topics on the cell, subscribed to while somebody looks."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from geometry_msgs.msg import PointStamped
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import CompressedImage, JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from im_core.ros import qos
from im_core.ros.node import ManagedNode
from im_pnt_display.page import cell

JOINTS_PERIOD_S = 0.1
"""How often positions of joints are shown [s]."""
IMAGES = "/image_raw/compressed"
_IMAGE_TYPE = "sensor_msgs/msg/CompressedImage"

Show = Callable[[str, Callable[[], Iterable[cell.Part]]], None]
"""Shows the parts of the cell in a message: its topic, and the function that reads it."""


class CellTopics:
    """Subscriptions of a node to the cell: robot, joints, frames, markers, images and spots."""

    def __init__(self, node: ManagedNode, show: Show) -> None:
        self._node, self._show = node, show
        self._subscriptions: list[Subscription] = []
        self._joints: bytes | None = None
        self._timer = node.create_timer(JOINTS_PERIOD_S, self._show_joints, clock=node.steady_clock)
        self._timer.cancel()

    def follow(self, looked_at: bool) -> None:
        """Begin to listen, or end; in the loop of the node."""
        if not looked_at:
            self._timer.cancel()
            for subscription in self._subscriptions:
                self._node.destroy_subscription(subscription)
            self._subscriptions = []
        elif not self._subscriptions:
            self._timer.reset()
            self._listen(String, "/robot_description", lambda told: [("robot", told.data)], qos.LATCHED)
            self._listen(TFMessage, "/tf_static", cell.frames, qos.LATCHED_MANY)
            self._listen(MarkerArray, "/markers", cell.markers, qos.LATCHED_MANY)
            self._subscriptions.append(
                self._node.create_subscription(JointState, "/joint_states", self._keep_joints, qos.SENSOR, raw=True)
            )
            for topic, types in self._node.get_topic_names_and_types():
                if topic.endswith(IMAGES) and _IMAGE_TYPE in types:
                    self._listen_to_camera(topic.removesuffix(IMAGES).strip("/"))

    def _listen_to_camera(self, name: str) -> None:
        self._listen(CompressedImage, f"/{name}{IMAGES}", lambda told: [cell.jpeg(name, told)], qos.IMAGES)
        self._listen(PointStamped, f"/{name}/spot", lambda told: [cell.spot(name, told)], qos.EVENTS)

    def _listen(self, kind: type, topic: str, read: Callable[[Any], Iterable[cell.Part]], profile: QoSProfile) -> None:
        def take(message: Any) -> None:
            self._show(topic, partial(read, message))

        self._subscriptions.append(self._node.create_subscription(kind, topic, take, profile))

    def _keep_joints(self, data: bytes) -> None:
        self._joints = data

    def _show_joints(self) -> None:
        if self._joints is not None:
            message, self._joints = deserialize_message(self._joints, JointState), None
            self._show("/joint_states", lambda: [cell.joints(message)])
