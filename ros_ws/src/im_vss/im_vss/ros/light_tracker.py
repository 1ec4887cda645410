"""Position of the lit wrist light by the robot's pose."""

from collections import deque

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from im_cell.lights import lights_told
from im_cell.robot import Cell
from im_cell.rotations import matrix_of_quaternion
from im_core import clock
from im_core.errors import DataError
from im_core.ros import qos
from im_core.ros.messages.interfaces import decoded
from im_vss.camera_poses import Pose

Array = NDArray[np.float64]

SWITCH = "/testbed/set_light"
"""Service that switches the wrist lights."""

_KEPT = 50
"""Messages on ``/tf``: others than MCS may send there, too, whatever they like."""

LATE_S = 0.5
"""How long a pose may be on its way to a busy node, wall time [s]."""
_LOOK_S = 0.005


class LightTracker:
    """Tracker of the light: keeps the newest of ``/tf`` undecoded, and computes a position on request."""

    def __init__(self, node: Node, cell: Cell, light: str, freshness_s: float, late_s: float) -> None:
        """Listen.

        Args:
            node: The node that listens.
            cell: Nominal geometry: where the lights are on the last links.
            light: Name of the light that counts unless another is the only one that is on, its name.
            freshness_s: How far a pose may be from the time that is asked for [s] of testbed time.
            late_s: How long to wait for a pose of that time, wall time [s]; 0 where the node's loop asks.
        """
        self._late_s = late_s
        self._cell, self._light, self._usual = cell, light, light
        self._freshness_ns = freshness_s * 1e9
        self._newest: deque[bytes] = deque(maxlen=_KEPT)
        self._lights: dict[str, bool] = {}
        node.create_subscription(TFMessage, "/tf", self._keep, qos.SENSOR, raw=True)
        node.create_subscription(String, "/testbed/lights", self._choose, qos.LATCHED)

    def why_dark(self) -> str:
        """Return the clause for dark lights, with the way to switch one on; empty if one is on, or nothing is known."""
        if not self._lights or any(self._lights.values()):
            return ""
        return f"{' and '.join(self._lights)} are off, {SWITCH} switches them on"

    def position(self, stamp_ns: int) -> Array | None:
        """The light in the world at a testbed time [ns], shape (3,) [m]; None if the pose then is not known."""
        carrier = self._cell.devices("light").get(self._light)
        wrist = carrier and self.wrist(carrier, stamp_ns)
        if not wrist:
            return None
        rotation, origin = wrist
        return np.asarray(origin + rotation @ np.array(self._cell.led.offset))

    def wrist(self, frame: str, stamp_ns: int) -> Pose | None:
        """Return the place of a wrist in the world at a testbed time [ns]; None if unknown.

        A pose of that time may be on its way to a busy node, while a newer one says that none will come.
        """
        deadline = clock.monotonic() + self._late_s
        while True:
            found, awaited = self._look(frame, stamp_ns)
            if found is not None or not awaited or clock.monotonic() > deadline:
                return found
            clock.sleep(_LOOK_S)

    def _look(self, frame: str, stamp_ns: int) -> tuple[Pose | None, bool]:
        """Return the place of a wrist by the messages that are there, and whether it may yet come."""
        newest: bool | None = None
        for message in reversed(tuple(self._newest)):
            try:
                return wrist_by(decoded(message, TFMessage), self._cell, frame, stamp_ns, self._freshness_ns), False
            except DataError as error:  # not from MCS, or of another time
                newest = bool(error.facts["earlier"]) if newest is None and "earlier" in error.facts else newest
        return None, bool(newest)

    def _keep(self, message: bytes) -> None:
        self._newest.append(message)

    def _choose(self, message: String) -> None:
        self._lights = lights_told(message.data, self._cell)
        on = [name for name, lit in self._lights.items() if lit]
        self._light = on[0] if len(on) == 1 else self._usual


def wrist_by(message: TFMessage, cell: Cell, frame: str, stamp_ns: int, freshness_ns: float) -> Pose:
    """Where the frames of one message put a wrist in the world.

    Args:
        message: Transforms, also as decoded out of a bag.
        cell: Nominal geometry.
        frame: The wrist, or another frame of the cell.
        stamp_ns: Testbed time that is asked for [ns].
        freshness_ns: How far the stamps of the frames may be from it [ns].

    Raises:
        DataError: A frame on the way is not in the message, of another time, or not turned by a quaternion of length 1.
    """
    tree = {each.child_frame_id: each for each in message.transforms}
    place = cell.tree.carrier(frame)
    (rotation, origin), frame, link = place.matrices(), place.parent, place.parent
    while frame != "world":
        if frame not in tree:  # or it was there before: a circle
            raise DataError(f"there is no way from {link} to the world")
        step_up = tree.pop(frame)
        header, q, t = step_up.header, step_up.transform.rotation, step_up.transform.translation
        ahead_ns = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec - stamp_ns
        if abs(ahead_ns) > freshness_ns:
            raise DataError(f"{frame} is of another time", earlier=ahead_ns < 0)
        step = matrix_of_quaternion([q.x, q.y, q.z, q.w])
        rotation, origin = step @ rotation, step @ origin + np.array([t.x, t.y, t.z])
        frame = header.frame_id
    return rotation, origin
