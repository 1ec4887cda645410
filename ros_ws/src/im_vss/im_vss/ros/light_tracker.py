"""Where the robot's pose puts the light of calibrations."""

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from scipy.spatial.transform import Rotation
from tf2_msgs.msg import TFMessage

from im_core.robot import Cell
from im_core.robot.tree import far_end
from im_core.ros import qos

Array = NDArray[np.float64]


class LightTracker:
    """Keeps the newest ``/tf`` as it came, and works it out when a position is asked for."""

    def __init__(self, node: Node, cell: Cell, light: str, freshness_s: float) -> None:
        """Listen.

        Args:
            node: The node that listens.
            cell: Nominal geometry: where the light is on the last link.
            light: Name of the light, ``<side>_led``.
            freshness_s: Largest age of a pose that says where the light is [s] of testbed time.
        """
        side = light.removesuffix("_led")
        xyz, rpy = far_end(cell.arm_models[cell.sides[side].arm].links[-1])
        self._link = f"{side}_link6"
        self._offset = np.array(xyz) + Rotation.from_euler("xyz", rpy).as_matrix() @ np.array(cell.led.offset)
        self._freshness_ns = freshness_s * 1e9
        self._newest: bytes | None = None
        node.create_subscription(TFMessage, "/tf", self._keep, qos.SENSOR, raw=True)

    def position(self, stamp_ns: int) -> Array | None:
        """The light in the world at a testbed time [ns], shape (3,) [m]; None if the pose then is not known."""
        if self._newest is None:
            return None
        tree = {each.child_frame_id: each for each in deserialize_message(self._newest, TFMessage).transforms}
        point, frame = self._offset, self._link
        while frame != "world":
            if frame not in tree:
                return None
            header, transform = tree[frame].header, tree[frame].transform
            if abs(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec - stamp_ns) > self._freshness_ns:
                return None
            q, t = transform.rotation, transform.translation
            point = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply(point) + np.array([t.x, t.y, t.z])
            frame = header.frame_id
        return np.asarray(point)

    def _keep(self, message: bytes) -> None:
        self._newest = message
