"""State of MCS, as messages."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from builtin_interfaces.msg import Duration
from control_msgs.msg import DynamicJointState, InterfaceValue
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, Quaternion
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectoryPoint

from im_core.ros.messages.stamps import to_stamp
from im_mcs.client.groups import GroupState
from im_mcs.limits.configuration import McsConfig
from im_mcs.limits.saturation import KINDS
from im_mcs.protocol.points import unpack_points
from im_mcs.state import State
from im_mcs.state.table import STATES
from im_mcs.testbed.driver import PowerReading
from im_msgs.msg import GroupPath, GroupStatus, McsState
from im_msgs.msg import GroupState as GroupStateMessage

_MOTION = ("position", "velocity", "effort")
_JOINT = (*_MOTION, "age", "brake")
_WRENCH = tuple(f"{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz")
_SILENCE_S = 1.0
# as many of the points of a trajectory are shown
_MOST_SHOWN = 200


def duration(seconds: float) -> Duration:
    """Return a duration from seconds."""
    nanoseconds = round(seconds * 1e9)
    return Duration(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


def pose(placement: pin.SE3) -> Pose:
    """Return a pose from a placement."""
    return _pose(pin.SE3ToXYZQUAT(placement).tolist())


def group_state(state: GroupState) -> GroupStateMessage:
    """Return an ``im_msgs/GroupState``."""
    message = GroupStateMessage(
        stamp=to_stamp(state.stamp_ns),
        group=state.group,
        joints=list(state.joints),
        q=state.q.tolist(),
        v=state.v.tolist(),
        at_rest=state.at_rest,
        rest_since=to_stamp(state.rest_since_ns),
        rest_window=state.rest_window,
        q_rest=state.q_rest.tolist(),
        q_rest_covariance=state.covariance.ravel().tolist(),
        jacobian=state.jacobian.ravel().tolist(),
    )
    if state.wrist is not None:
        message.wrist = pose(state.wrist)
    return message


def joint_state(names: tuple[str, ...], sample: dict[str, Any], jaw_speeds: Sequence[float]) -> JointState:
    """Return a ``sensor_msgs/JointState`` of a sample of the servo.

    Args:
        names: Of the joints, then of the grippers.
        sample: Of the servo.
        jaw_speeds: Of the grippers [m/s].
    """
    message = JointState(
        name=list(names),
        position=[*sample["q"], *sample["gripper"]],
        velocity=[*sample["v"], *jaw_speeds],
        effort=[*sample["tau"], *sample["gripper_force"]],
    )
    message.header.stamp = to_stamp(int(sample["stamp_ns"]))
    return message


def dynamic_joint_state(joints: JointState, sensors: Sequence[str], sample: dict[str, Any]) -> DynamicJointState:
    """Return a ``control_msgs/DynamicJointState``: all that is measured, by joint, gripper and force-torque sensor.

    Args:
        joints: The joints, then the grippers, as :func:`joint_state` has them.
        sensors: Names of the force-torque sensors.
        sample: Of the servo; of a joint also the ``age`` of the reading [s], and ``brake``, 1 when it holds.
    """
    motions = list(zip(joints.position, joints.velocity, joints.effort, strict=True))
    held = list(zip(sample["age"], sample["brakes"], strict=True))
    values: list[tuple[Sequence[str], Iterable[float]]]
    values = [(_JOINT, (*motion, *more)) for motion, more in zip(motions, held, strict=False)]
    values += [(_MOTION, motion) for motion in motions[len(held) :]]
    values += [(_WRENCH, wrench) for wrench in sample["wrench"]]
    return DynamicJointState(
        header=joints.header,
        joint_names=[*joints.name, *sensors],
        interface_values=[InterfaceValue(interface_names=names, values=map(float, row)) for names, row in values],
    )


def group_path(joints: Sequence[str], path: dict[str, Any], stamp_ns: int) -> GroupPath:
    """Return the ``path`` of a MOVE request as ``im_msgs/GroupPath``, a long trajectory at equal distances."""
    message = GroupPath(stamp=to_stamp(stamp_ns), kind=path["kind"], blend=float(path.get("blend", 0.0)))
    if path["kind"] == "line":
        message.arc = bool(path.get("arc"))
        message.line = [_pose(values) for values in path.get("poses") or ()]
        message.relative = [_pose(values) for values in path.get("relative") or ()]
        if "points" not in path:
            return message
    message.path.joint_names = list(joints)
    if path["kind"] != "trajectory":
        message.path.points = [JointTrajectoryPoint(positions=positions) for positions in path["points"]]
        return message
    points = unpack_points(path["points"])
    many = len(points.times)
    for k in np.linspace(0, many - 1, min(many, _MOST_SHOWN)).astype(np.intp):
        item = trajectory_point(x[k] for x in (points.q, points.v, points.a) if x is not None)
        item.time_from_start = duration(float(points.times[k]))
        message.path.points.append(item)
    return message


def _pose(values: Sequence[float]) -> Pose:
    x, y, z, *turn = values
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(**dict(zip("xyzw", turn, strict=True))))


def trajectory_point(values: Iterable[NDArray[np.float64]]) -> JointTrajectoryPoint:
    """A point of positions, velocities and accelerations; of those that are given."""
    point = JointTrajectoryPoint()
    for name, value in zip(("positions", "velocities", "accelerations"), values, strict=False):
        setattr(point, name, value)
    return point


def mcs_state(
    config: McsConfig, state: State, reason: str, snapshot: NDArray[np.void] | None, past: PowerReading | None
) -> McsState:
    """Return an ``im_msgs/McsState``.

    Args:
        config: Configuration.
        state: State of MCS.
        reason: Why it is there, or empty.
        snapshot: What the servo told last, None if there is none.
        past: Power and brakes, read past a servo that says nothing of them now; None where the snapshot measures them.
    """
    message = McsState(
        state=state.value, reason=reason, brakes=True, preset=config.preset, period=config.servo.period_s
    )
    if past is not None:
        message.power, message.brakes = past
    if snapshot is None or state is State.UNCONFIGURED:
        return message
    stopped = state is State.ESTOPPED
    groups = [
        group_status(config, row, snapshot, stopped, past)
        for row in snapshot["groups"]
        if text(row["name"]) in config.groups
    ]
    held = snapshot["brakes"][snapshot["reserved"]]
    message.stamp = to_stamp(int(snapshot["stamp_ns"]))
    if past is None:
        message.power = bool(snapshot["power"])
        message.brakes = bool(held.all()) if held.size else bool(snapshot["brakes"].all())
    message.groups = groups
    message.reserved_groups = [group.group for group in groups if group.reserved]
    message.paused_groups = [group.group for group in groups if group.paused]
    message.protective_stop = next((group.protective_stop for group in groups if group.protective_stop), "")
    message.tick = int(snapshot["tick"])
    message.missed_deadlines = int(snapshot["missed_deadlines"])
    message.saturations = int(snapshot["saturations"].sum())
    message.distance = float(snapshot["distance"])
    message.closest = [name for name in map(text, snapshot["closest"]) if name]
    message.mean_period = float(snapshot["mean_period_s"])
    message.real_time_scheduling = bool(snapshot["real_time"])
    return message


def group_status(
    config: McsConfig, row: np.void, snapshot: NDArray[np.void], stopped: bool, past: PowerReading | None
) -> GroupStatus:
    """Return an ``im_msgs/GroupStatus`` of a row of the snapshot's groups.

    Args:
        config: Configuration.
        row: What the servo told last of the group.
        snapshot: What it told last of everything.
        stopped: Whether MCS is estopped, which the servo may not have told yet.
        past: As of :func:`mcs_state`.
    """
    name = text(row["name"])
    slots = [slot.name for slot in config.joint_slots]
    index = [slots.index(joint) for joint in config.groups[name].joints]
    return GroupStatus(
        group=name,
        state=(State.ESTOPPED if stopped else STATES[int(row["state"])]).value,
        brakes=bool(snapshot["brakes"][index].all()) if past is None else past.braked,
        reserved=bool(row["reserved"]),
        owner=text(row["owner"]),
        lease=float(row["lease_left_s"]),
        lapsed=bool(row["lapsed"]),
        moving=bool(row["moving"]),
        paused=bool(row["paused"]),
        speed=float(row["speed"]),
        controller=text(row["controller"]),
        protective_stop=text(row["protective_stop"]),
        saturations=snapshot["saturations"][:, index].sum(axis=1).astype(np.uint64),
    )


def states(snapshot: NDArray[np.void]) -> dict[str, State]:
    """State of each group."""
    return {name: STATES[int(row["state"])] for row in snapshot["groups"] if (name := text(row["name"]))}


def laws(snapshot: NDArray[np.void]) -> dict[str, str]:
    """Control law in force of each group."""
    return {text(row["name"]): text(row["controller"]) for row in snapshot["groups"]}


def speeds(snapshot: NDArray[np.void]) -> dict[str, float]:
    """Rate in force of each group: 1 as planned, 0 halted."""
    return {text(row["name"]): float(row["speed"]) for row in snapshot["groups"]}


def text(value: bytes) -> str:
    """Return a text of the snapshot, without a letter cut in the middle."""
    return bytes(value).decode(errors="ignore")


def servo_missing(state: State, reason: str) -> DiagnosticStatus:
    """Return the status of a missing servo process, with the reason."""
    level = DiagnosticStatus.ERROR if reason else DiagnosticStatus.STALE
    message = f"{state.value}: {reason}" if reason else state.value
    return DiagnosticStatus(name="mcs: servo", hardware_id="testbed", level=level, message=message)


def servo_status(state: State, snapshot: NDArray[np.void], silence_s: float) -> DiagnosticStatus:
    """Return the timing of the servo loop; ``silence_s``: since the last heartbeat [s]."""
    status = DiagnosticStatus(name="mcs: servo", hardware_id="testbed", message=state.value)
    linked = bool(snapshot["linked"])
    status.level = DiagnosticStatus.OK if linked and state is not State.ESTOPPED else DiagnosticStatus.ERROR
    if not linked:
        status.message = f"{state.value}; the testbed does not answer"
    if silence_s > _SILENCE_S:
        status.level = DiagnosticStatus.ERROR
        status.message = f"{state.value}; the servo has given no heartbeat for {silence_s:.1f} s"
    for key in ("tick", "ticks", "missed_deadlines"):
        status.values.append(KeyValue(key=key, value=str(int(snapshot[key]))))
    for kind, counts in zip(KINDS, snapshot["saturations"], strict=True):
        status.values.append(KeyValue(key=f"saturations_{kind}", value=str(int(counts.sum()))))
    for row in snapshot["groups"]:
        if name := text(row["name"]):
            status.values.append(KeyValue(key=f"late_torques_{name}", value=str(int(row["late_torques"]))))
    for key in ("mean_period_s", "max_lateness_s", "mean_compute_s"):
        status.values.append(KeyValue(key=key, value=f"{float(snapshot[key]):.6f}"))
    status.values.append(KeyValue(key="real_time_scheduling", value=str(bool(snapshot["real_time"])).lower()))
    return status


def lifecycle_status(label: str, failure: str) -> DiagnosticStatus:
    """Return the state of the lifecycle, and the reason of the last failed transition."""
    level = DiagnosticStatus.WARN if failure else DiagnosticStatus.OK
    status = DiagnosticStatus(name="mcs: lifecycle", hardware_id="testbed", level=level, message=failure or label)
    status.values.append(KeyValue(key="state", value=label))
    return status


def refusals_status(refused: Mapping[str, int]) -> DiagnosticStatus:
    """Return the refused messages on topics."""
    commands = DiagnosticStatus(name="mcs: refused messages", hardware_id="testbed", message=f"{sum(refused.values())}")
    commands.level = DiagnosticStatus.WARN if refused else DiagnosticStatus.OK
    commands.values = [KeyValue(key=topic, value=str(count)) for topic, count in sorted(refused.items())]
    return commands


def take_overs_status(taken_over: Mapping[str, str]) -> DiagnosticStatus:
    """Return the takeovers of groups, with the former owners."""
    owners = DiagnosticStatus(name="mcs: groups taken over", hardware_id="testbed", message=f"{len(taken_over)}")
    owners.level = DiagnosticStatus.WARN if taken_over else DiagnosticStatus.OK
    owners.values = [KeyValue(key=group, value=sentence) for group, sentence in sorted(taken_over.items())]
    return owners


def fill_placement(translation: Any, rotation: Any, placement: pin.SE3) -> None:
    """Put a placement into the two parts of a pose or transform."""
    values = pin.SE3ToXYZQUAT(placement).tolist()
    translation.x, translation.y, translation.z, rotation.x, rotation.y, rotation.z, rotation.w = values
