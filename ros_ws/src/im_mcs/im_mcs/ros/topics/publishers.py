"""All publishers of ``/mcs``."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TransformStamped
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from im_cell.robot import Cell, urdf
from im_core.ros import qos
from im_core.ros.stamps import to_stamp
from im_mcs.limits.configuration import McsConfig
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel
from im_mcs.ros import messages
from im_mcs.state import State
from im_mcs.testbed.driver import PowerReading
from im_msgs.msg import McsState


class Publishers:
    """Topics of MCS; ``/robot_description`` and ``/tf_static`` are published at once and latched.

    Args:
        node: The node that publishes.
        model: Kinematics; used by this object alone.
        limits: Those in force; ``/robot_description`` says what is enforced, not what the hardware could do.
    """

    def __init__(self, node: Node, model: CellModel, limits: JointLimits) -> None:
        self._names = model.names
        self._frames = Frames(model.cell, model)
        self._state = node.create_publisher(McsState, "/mcs/state", qos.LATCHED)
        self._joints = node.create_publisher(JointState, "/joint_states", qos.EVENTS)
        self._tf = node.create_publisher(TFMessage, "/tf", qos.EVENTS)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", qos.EVENTS)
        self._tf_static = node.create_publisher(TFMessage, "/tf_static", qos.LATCHED)
        self._tf_static.publish(TFMessage(transforms=self._frames.fixed()))
        self._description = node.create_publisher(String, "/robot_description", qos.LATCHED)
        self._description.publish(String(data=urdf(model.cell, limits=limits.enforced())))

    def state(
        self, config: McsConfig, state: State, reason: str, snapshot: NDArray[np.void] | None, past: PowerReading | None
    ) -> None:
        """Publish ``/mcs/state``; arguments as of :func:`im_mcs.ros.messages.mcs_state`."""
        self._state.publish(messages.mcs_state(config, state, reason, snapshot, past))

    def joints(self, samples: list[dict[str, Any]]) -> None:
        """Publish ``/joint_states`` and ``/tf`` of every sample of the servo, for subscribers only."""
        if self._joints.get_subscription_count():
            for sample in samples:
                self._joints.publish(messages.joint_state(self._names, sample))
        if self._tf.get_subscription_count():
            for sample in samples:
                self._tf.publish(self._frames.moving(np.array(sample["q"]), sample["stamp_ns"]))

    def diagnostics(self, stamp_ns: int, statuses: Sequence[DiagnosticStatus]) -> None:
        """Publish ``/diagnostics``."""
        message = DiagnosticArray(status=list(statuses))
        message.header.stamp = to_stamp(stamp_ns)
        self._diagnostics.publish(message)


class Frames:
    """Transforms of the cell's links.

    Args:
        cell: Joints, links and fixed frames.
        model: Kinematics; used by this object alone.
    """

    def __init__(self, cell: Cell, model: CellModel) -> None:
        self._model = model
        moving = [(joint.parent, joint.child) for joint in cell.joints]
        names = {parent for parent, _ in moving} | {child for _, child in moving}
        self._fixed = [(_parent_frame(model, name), name) for name in model.poses(cell.home) if name not in names]
        self._home = cell.home
        unfilled = TFMessage(transforms=[_transform(parent, child) for parent, child in moving])
        self._moving = bytearray(serialize_message(unfilled))
        self._stamps, self._placements = _places(self._moving, len(moving))

    def moving(self, q: NDArray[np.float64], stamp_ns: int) -> bytes:
        """Return transforms over the joints at ``q``, shape (18,), as the bytes (CDR) of a ``TFMessage``.

        Fifty a second are told, and only numbers in them change: making the objects anew took most of the node's time.
        """
        stamp = divmod(stamp_ns, 1_000_000_000)
        for told, values, placement in zip(self._stamps, self._placements, self._model.over_joints(q), strict=True):
            told[:] = stamp
            values[:] = pin.SE3ToXYZQUAT(placement)
        return bytes(self._moving)

    def fixed(self) -> list[TransformStamped]:
        """Return transforms of frames fixed to a link."""
        poses = self._model.poses(self._home)
        poses.setdefault("world", pin.SE3.Identity())
        transforms = []
        for parent, child in self._fixed:
            message = _transform(parent, child)
            placement = poses[parent].actInv(poses[child])
            messages.fill_placement(message.transform.translation, message.transform.rotation, placement)
            transforms.append(message)
        return transforms


def _places(message: bytearray, count: int) -> tuple[list[NDArray[np.int32]], list[NDArray[np.float64]]]:
    """Return the offsets of the numbers of each transform in the bytes of a ``TFMessage``.

    Args:
        message: As rclpy serialises it (CDR): four bytes of encapsulation, from which on things are aligned.
        count: How many transforms it has.

    Returns:
        Seconds and nanoseconds, shape (2,), and translation and quaternion, shape (7,); writing there changes it.
    """
    stamps, placements = [], []
    at = 8
    for _ in range(count):
        stamps.append(np.ndarray(2, "<i4", message, at))
        at += 8
        for _ in ("frame_id", "child_frame_id"):
            at += 4 + int.from_bytes(message[at : at + 4], "little")
            at += -at % 4
        at += (4 - at) % 8
        placements.append(np.ndarray(7, "<f8", message, at))
        at += 56
    return stamps, placements


def _transform(parent: str, child: str) -> TransformStamped:
    """Return a transform with the names, without numbers."""
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    return message


def _parent_frame(model: CellModel, name: str) -> str:
    """Return the nearest body above a fixed frame."""
    frame = model.pin.frames[model.frame_id(name)]
    parent = model.pin.frames[frame.parentFrame]
    while parent.type != pin.FrameType.BODY and parent.name != "universe":
        parent = model.pin.frames[parent.parentFrame]
    return "world" if parent.name == "universe" else str(parent.name)
