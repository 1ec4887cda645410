"""All publishers of ``/mcs``."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from control_msgs.msg import DynamicJointState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, TransformStamped
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from im_cell.robot import Cell, Hull, robot_description
from im_core.ros import qos
from im_core.ros.messages.stamps import to_stamp
from im_mcs.collision.bodies import faces_of
from im_mcs.limits.configuration import McsConfig
from im_mcs.limits.limits import JointLimits
from im_mcs.ros import messages
from im_msgs.msg import McsState


class Publishers:
    """Topics of MCS; ``/robot_description``, ``/tf_static`` and ``/markers`` of hulls are published at once, latched.

    Args:
        node: The node that publishes.
        cell: The cell.
        config: Names of the slots of grippers and force-torque sensors, in the order of the samples.
        limits: Those in force; ``/robot_description`` says what is enforced, not what the hardware could do.
    """

    def __init__(self, node: Node, cell: Cell, config: McsConfig, limits: JointLimits) -> None:
        grippers = [slot.name for slot in config.gripper_slots]
        self._names = (*cell.joint_names, *grippers)
        self._sensors = [slot.name for slot in config.wrench_slots]
        description = robot_description(cell, limits.enforced())
        self._frames = Frames(description, self._names)
        self._jaws = JawSpeeds(len(grippers))
        self._state = node.create_publisher(McsState, "/mcs/state", qos.LATCHED)
        self._joints = node.create_publisher(JointState, "/joint_states", qos.EVENTS)
        self._dynamic = node.create_publisher(DynamicJointState, "/dynamic_joint_states", qos.EVENTS)
        self._tf = node.create_publisher(TFMessage, "/tf", qos.EVENTS)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", qos.EVENTS)
        self._rates = node.create_publisher(DiagnosticArray, "/mcs/rates", qos.LATCHED)
        self._tf_static = node.create_publisher(TFMessage, "/tf_static", qos.LATCHED)
        self._tf_static.publish(TFMessage(transforms=self._frames.fixed()))
        self._description = node.create_publisher(String, "/robot_description", qos.LATCHED)
        self._description.publish(String(data=description))
        if cell.hulls:
            self._hulls = node.create_publisher(MarkerArray, "/markers", qos.LATCHED)
            markers = [_hull(rank, hull, cell.color_of(hull.link)) for rank, hull in enumerate(cell.hulls)]
            self._hulls.publish(MarkerArray(markers=markers))

    def state(self, state: McsState) -> None:
        """Publish ``/mcs/state``."""
        self._state.publish(state)

    def joints(self, samples: list[dict[str, Any]]) -> None:
        """Publish ``/joint_states``, ``/dynamic_joint_states`` and ``/tf`` of every sample, for subscribers only."""
        plain, dynamic = (topic.get_subscription_count() > 0 for topic in (self._joints, self._dynamic))
        for sample in samples:
            speeds = self._jaws.take_sample(sample)
            if not plain and not dynamic:
                continue
            message = messages.joint_state(self._names, sample, speeds)
            if plain:
                self._joints.publish(message)
            if dynamic:
                self._dynamic.publish(messages.dynamic_joint_state(message, self._sensors, sample))
        if self._tf.get_subscription_count():
            for sample in samples:
                positions = np.array([*sample["q"], *sample["gripper"]])
                self._tf.publish(self._frames.moving(positions, sample["stamp_ns"]))

    def diagnostics(self, stamp_ns: int, statuses: Sequence[DiagnosticStatus]) -> None:
        """Publish ``/diagnostics``."""
        self._diagnostics.publish(_array(stamp_ns, statuses))

    def rates(self, stamp_ns: int, statuses: Sequence[DiagnosticStatus]) -> None:
        """Publish ``/mcs/rates``: the timing of the functions of the servo loop."""
        self._rates.publish(_array(stamp_ns, statuses))


def _array(stamp_ns: int, statuses: Sequence[DiagnosticStatus]) -> DiagnosticArray:
    message = DiagnosticArray(status=list(statuses))
    message.header.stamp = to_stamp(stamp_ns)
    return message


def _hull(rank: int, hull: Hull, color: Sequence[float]) -> Marker:
    """Return the faces of a hull, without its margin."""
    marker = Marker(ns="hulls", id=rank, type=Marker.TRIANGLE_LIST, action=Marker.ADD, frame_locked=True)
    marker.header.frame_id = hull.link
    marker.scale.x = marker.scale.y = marker.scale.z = marker.color.a = 1.0
    marker.color.r, marker.color.g, marker.color.b = color
    corners = faces_of(np.array(hull.points)).reshape(-1, 3).tolist()
    marker.points = [Point(x=x, y=y, z=z) for x, y, z in corners]
    return marker


class JawSpeeds:
    """Speeds of the jaws by differences of their openings; 0 where there is nothing to compare with."""

    def __init__(self, count: int) -> None:
        self._stamp_ns, self._openings, self._speeds = 0, [0.0] * count, [0.0] * count

    def take_sample(self, sample: dict[str, Any]) -> list[float]:
        """Return the speeds at a sample of the servo [m/s]; the same sample may come again."""
        openings, seconds = sample["gripper"], 1e-9 * (sample["stamp_ns"] - self._stamp_ns)
        if seconds != 0.0:
            known = self._stamp_ns and seconds > 0.0  # else it is the first, or of another start of the testbed
            before = self._openings if known else openings
            self._speeds = [(now - then) / seconds for now, then in zip(openings, before, strict=True)]
            self._stamp_ns, self._openings = sample["stamp_ns"], openings
        return self._speeds


class Frames:
    """Transforms of the frames of a robot description.

    Args:
        description: As URDF.
        names: Joints whose positions are known, in their order; what other joints move is left out.
    """

    def __init__(self, description: str, names: Sequence[str]) -> None:
        self._model = pin.buildModelFromXML(description)
        self._data = self._model.createData()
        self._q = pin.neutral(self._model)
        joints = {joint.attrib["name"]: joint for joint in ET.fromstring(description).iterfind("joint")}
        pairs = {name: _ends(joint) for name, joint in joints.items()}
        moving = [name for name in self._model.names if name in joints]
        children = {pairs[name][1] for name in moving}
        self._fixed = [
            (self._model.frames[frame.parentFrame], frame)
            for frame in self._model.frames
            if frame.type == pin.FrameType.BODY and frame.name not in children and frame.parentFrame > 0
        ]
        leads = {name: _lead(name, joints[name]) for name in moving}
        shown = [name for name in moving if leads[name][0] in names]
        self._joints = [self._model.getJointId(name) for name in shown]
        self._places = [self._model.idx_qs[joint] for joint in self._joints]
        self._sources = [names.index(leads[name][0]) for name in shown]
        self._shares = np.array([leads[name][1] for name in shown])
        unfilled = TFMessage(transforms=[_transform(*pairs[name]) for name in shown])
        self._message = bytearray(serialize_message(unfilled))
        self._stamps, self._placements = _places(self._message, len(shown))

    def moving(self, positions: NDArray[np.float64], stamp_ns: int) -> bytes:
        """Return transforms over the joints at positions, shape (names,), as the bytes (CDR) of a ``TFMessage``.

        Many a second are told, and only numbers in them change: making the objects anew took most of the node's time.
        """
        self._q[self._places] = self._shares * positions[self._sources]
        pin.forwardKinematics(self._model, self._data, self._q)
        stamp = divmod(stamp_ns, 1_000_000_000)
        for told, values, joint in zip(self._stamps, self._placements, self._joints, strict=True):
            told[:] = stamp
            values[:] = pin.SE3ToXYZQUAT(self._data.liMi[joint])
        return bytes(self._message)

    def fixed(self) -> list[TransformStamped]:
        """Return transforms of frames fixed to a link."""
        transforms = []
        for joint, frame in self._fixed:
            parent = self._model.frames[joint.parentFrame]
            message = _transform(parent.name, frame.name)
            placement = parent.placement.actInv(frame.placement)
            messages.fill_placement(message.transform.translation, message.transform.rotation, placement)
            transforms.append(message)
        return transforms


def _ends(joint: ET.Element) -> tuple[str, str]:
    """Parent and child of a joint."""
    parent, child = joint.find("parent"), joint.find("child")
    assert parent is not None
    assert child is not None
    return parent.attrib["link"], child.attrib["link"]


def _lead(name: str, joint: ET.Element) -> tuple[str, float]:
    """Joint that a joint follows, and by how much of its position; a joint by default follows itself."""
    mimic = joint.find("mimic")
    return (name, 1.0) if mimic is None else (mimic.attrib["joint"], float(mimic.attrib["multiplier"]))


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
