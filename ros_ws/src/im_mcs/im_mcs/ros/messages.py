"""What MCS knows, as messages."""

from typing import Any

import numpy as np
import pinocchio as pin
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Pose, TransformStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState

from im_core.robot import Cell
from im_mcs.client.group_state import GroupState
from im_mcs.config import McsConfig
from im_mcs.model import Model
from im_mcs.state import State
from im_msgs.msg import GroupState as GroupStateMessage
from im_msgs.msg import McsState


def time(stamp_ns: int) -> Time:
    """A stamp from nanoseconds."""
    return Time(sec=stamp_ns // 1_000_000_000, nanosec=stamp_ns % 1_000_000_000)


def pose(placement: pin.SE3) -> Pose:
    """A pose from a placement."""
    message = Pose()
    _fill(message.position, message.orientation, placement)
    return message


def group_state(state: GroupState) -> GroupStateMessage:
    """``im_msgs/GroupState``."""
    message = GroupStateMessage(
        stamp=time(state.stamp_ns),
        group=state.group,
        joints=list(state.joints),
        q=state.q.tolist(),
        v=state.v.tolist(),
        at_rest=state.at_rest,
        rest_since=time(state.rest_since_ns),
        rest_window=state.rest_window,
        q_rest=state.q_rest.tolist(),
        q_rest_covariance=state.covariance.ravel().tolist(),
        jacobian=state.jacobian.ravel().tolist(),
    )
    if state.wrist is not None:
        message.wrist = pose(state.wrist)
    return message


def joint_state(names: tuple[str, ...], sample: dict[str, Any]) -> JointState:
    """``sensor_msgs/JointState`` of a sample of the servo."""
    message = JointState(name=list(names), position=sample["q"], velocity=sample["v"], effort=sample["tau"])
    message.header.stamp = time(int(sample["stamp_ns"]))
    return message


def mcs_state(config: McsConfig, state: State, reason: str, snapshot: NDArray[np.void] | None) -> McsState:
    """``im_msgs/McsState``."""
    message = McsState(
        state=state.value, reason=reason, brakes=True, preset=config.preset, period=config.servo.period_s
    )
    if snapshot is not None and state is not State.UNCONFIGURED:
        reserved = dict(zip([slot.name for slot in config.joint_slots], snapshot["reserved"].tolist(), strict=True))
        held = snapshot["brakes"][snapshot["reserved"]]
        message.stamp = time(int(snapshot["stamp_ns"]))
        message.power = bool(snapshot["power"])
        message.brakes = bool(held.all()) if held.size else bool(snapshot["brakes"].all())
        message.reserved_groups = [name for name, g in config.groups.items() if all(reserved[j] for j in g.joints)]
        message.tick = int(snapshot["tick"])
        message.missed_deadlines = int(snapshot["missed_deadlines"])
        message.mean_period = float(snapshot["mean_period_s"])
        message.real_time_scheduling = bool(snapshot["real_time"])
    return message


def diagnostics(state: State, snapshot: NDArray[np.void]) -> DiagnosticArray:
    """How the servo loop keeps time."""
    status = DiagnosticStatus(name="mcs: servo", hardware_id="testbed", message=state.value)
    linked = bool(snapshot["linked"])
    status.level = DiagnosticStatus.OK if linked and state is not State.ESTOPPED else DiagnosticStatus.ERROR
    if not linked:
        status.message = f"{state.value}; the testbed does not answer"
    for key in ("tick", "ticks", "missed_deadlines", "saturations"):
        status.values.append(KeyValue(key=key, value=str(int(snapshot[key]))))
    for key in ("mean_period_s", "max_lateness_s", "mean_compute_s"):
        status.values.append(KeyValue(key=key, value=f"{float(snapshot[key]):.6f}"))
    status.values.append(KeyValue(key="real_time_scheduling", value=str(bool(snapshot["real_time"])).lower()))
    message = DiagnosticArray(status=[status])
    message.header.stamp = time(int(snapshot["stamp_ns"]))
    return message


class Frames:
    """Transforms of the cell's links.

    Args:
        cell: Joints, links and fixed frames.
        model: Kinematics; used by this object alone.
    """

    def __init__(self, cell: Cell, model: Model) -> None:
        self._model = model
        self._moving = [(joint.parent, joint.child) for joint in cell.joints]
        names = {parent for parent, _ in self._moving} | {child for _, child in self._moving}
        self._fixed = [(_parent_frame(model, name), name) for name in model.poses(cell.home) if name not in names]
        self._home = cell.home

    def moving(self, q: NDArray[np.float64], stamp_ns: int) -> list[TransformStamped]:
        """Transforms over the joints at ``q``, shape (18,)."""
        return self._transforms(self._moving, q, stamp_ns)

    def fixed(self) -> list[TransformStamped]:
        """Transforms of frames that are fixed to a link."""
        return self._transforms(self._fixed, self._home, 0)

    def _transforms(
        self, pairs: list[tuple[str, str]], q: NDArray[np.float64], stamp_ns: int
    ) -> list[TransformStamped]:
        poses = self._model.poses(q)
        poses.setdefault("world", pin.SE3.Identity())
        stamp = time(stamp_ns)
        messages = []
        for parent, child in pairs:
            message = TransformStamped(child_frame_id=child)
            message.header.frame_id, message.header.stamp = parent, stamp
            placement = poses[parent].actInv(poses[child])
            _fill(message.transform.translation, message.transform.rotation, placement)
            messages.append(message)
        return messages


def _parent_frame(model: Model, name: str) -> str:
    """Nearest body that a fixed frame hangs on."""
    frame = model.pin.frames[model.frame_id(name)]
    parent = model.pin.frames[frame.parentFrame]
    while parent.type != pin.FrameType.BODY and parent.name != "universe":
        parent = model.pin.frames[parent.parentFrame]
    return "world" if parent.name == "universe" else str(parent.name)


def _fill(translation: Any, rotation: Any, placement: pin.SE3) -> None:
    translation.x, translation.y, translation.z = (float(value) for value in placement.translation)
    rotation.x, rotation.y, rotation.z, rotation.w = (float(v) for v in pin.Quaternion(placement.rotation).coeffs())
