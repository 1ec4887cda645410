"""Topics for driving a layer, for the owner of the slots; and for jogs, commands and speed as ros2_control has them."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from control_msgs.msg import JointJog, SpeedScalingFactor
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import TwistStamped
from numpy.typing import NDArray
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray, Header

from im_core.errors import DataError, ImError
from im_core.ros import qos
from im_mcs.client.points import joint_order, ordered
from im_mcs.client.servo_client import ServoReply
from im_mcs.client.trajectory import Accepted, joint_ranks
from im_mcs.planning.motions.jog import JogLimit
from im_mcs.planning.motions.stream import LAPSED
from im_mcs.protocol.requests import LONGEST_LEASE_S
from im_mcs.ros.access import McsAccess
from im_mcs.ros.messages import text
from im_mcs.state import Event
from im_msgs.msg import SetpointCommand, TorqueCommand

Translate = Callable[[str, Any], dict[str, Any]]
"""Arguments of a request from a group and a message."""

_TIMEOUT = "incoming_command_timeout"
_LEAST_S, _USUAL_S = 0.01, 0.1
_TIMEOUT_WHAT = (
    "How long a velocity or an effort of a topic without owners holds, by testbed time [s]; then the group ramps down "
    "to rest. In force from the next message on."
)
_COMMANDS = {"position": ("setpoint", "positions"), "velocity": ("jog", "velocities"), "effort": ("torque", "torques")}
"""Kind and field of a request for the commands of each of ros2_control's forwarding controllers."""
_LIMITS = {
    JogLimit.NONE: (DiagnosticStatus.OK, "no limit slows it down"),
    JogLimit.SINGULARITY_AHEAD: (DiagnosticStatus.WARN, "slowed down: a singularity is ahead"),
    JogLimit.SINGULARITY: (DiagnosticStatus.ERROR, "halted before a singularity; jog away from it"),
    JogLimit.COLLISION_AHEAD: (DiagnosticStatus.WARN, "slowed down: bodies are close"),
    JogLimit.COLLISION: (DiagnosticStatus.ERROR, "halted: bodies would come too close; stop sending, then jog away"),
    JogLimit.JOINT_RANGE: (DiagnosticStatus.ERROR, "slowed down or halted at the end of the range of a joint"),
    JogLimit.VELOCITY: (DiagnosticStatus.WARN, "slowed down to the velocity limit of a joint"),
    JogLimit.HELD: (DiagnosticStatus.ERROR, "halted by a pause or a protective stop; resume the group"),
}


class CommandTopics:
    """``/<group>/command/setpoints`` and ``/<group>/command/torques`` of every group of every preset.

    ``/<group>/speed_scaling_input`` as with ros2_control's trajectory controller: the last message, also a latched one
    that comes late, is the share of the planned speed. ``/<group>/delta_joint_cmds`` and ``delta_twist_cmds`` as of
    moveit_servo, whose ``status`` is ``/<group>/jog_status``. ``/<group>/forward_position_controller/commands``, and
    the same of velocity and effort, as of ros2_control's forwarding controllers. These tell no sender: a group with an
    owner does not obey them.

    Parameter: ``incoming_command_timeout`` [s].
    """

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        span = _LEAST_S, LONGEST_LEASE_S
        access.node.declared.declare(_TIMEOUT, _USUAL_S, _TIMEOUT_WHAT, span=span, changeable=True)
        for group in access.group_names:
            self._listen(SetpointCommand, group, "command/setpoints", Event.STREAM, self._setpoint)
            self._listen(TorqueCommand, group, "command/torques", Event.STREAM, self._torque)
            self._listen(SpeedScalingFactor, group, "speed_scaling_input", Event.SET_SPEED, self._scale, qos.LATCHED)
            self._listen(JointJog, group, "delta_joint_cmds", Event.STREAM, self._jog)
            self._listen(TwistStamped, group, "delta_twist_cmds", Event.STREAM, self._twist)
            for quantity in _COMMANDS:
                name = f"forward_{quantity}_controller/commands"
                self._listen(Float64MultiArray, group, name, Event.STREAM, partial(self._command, quantity))
        self._status = {
            group: access.node.create_publisher(DiagnosticStatus, f"/{group}/jog_status", qos.LATCHED)
            for group in access.group_names
        }
        self._told: dict[str, int] = {}

    def publish_status(self, snapshot: NDArray[np.void]) -> None:
        """Publish what slows down or halts the jog of each group, when that changes."""
        for row in snapshot["groups"]:
            group, limit = text(row["name"]), int(row["jog_limit"])
            if group and self._told.get(group) != limit:
                self._told[group] = limit
                level, message = _LIMITS[JogLimit(limit)]
                values = [KeyValue(key="code", value=str(limit))]
                status = DiagnosticStatus(level=level, name=f"jog of {group}", message=message, values=values)
                self._status[group].publish(status)

    def _listen(
        self,
        message_type: type,
        group: str,
        name: str,
        event: Event,
        translate: Translate,
        profile: QoSProfile = qos.EVENTS,
    ) -> None:
        topic = f"/{group}/{name}"
        self._mcs.node.create_subscription(
            message_type, topic, partial(self._take, group, topic, event, translate), profile
        )

    def _take(self, group: str, topic: str, event: Event, translate: Translate, message: Any) -> None:
        wanted_ends = () if isinstance(message, SetpointCommand | TorqueCommand) else (LAPSED, "replaced")

        def answer(reply: ServoReply) -> None:
            if reply.error is not None and reply.error.code not in wanted_ends:
                self._mcs.refusals.add(topic, reply.error)

        try:
            self._mcs.check(message)
            self._mcs.client().send(event, {"group": group, **translate(group, message)}, answer)
        except ImError as error:
            self._mcs.refusals.add(topic, error)

    def _setpoint(self, group: str, message: SetpointCommand) -> dict[str, Any]:
        order, joints = self._order(group, message)
        positions = ordered(message.position, order, joints, "position")
        velocities = ordered(message.velocity, order, joints, "velocity") if message.velocity else []
        return {"kind": "setpoint", "positions": positions, "velocities": velocities, **_lease(message)}

    def _torque(self, group: str, message: TorqueCommand) -> dict[str, Any]:
        torques = ordered(message.torque, *self._order(group, message), "torque")
        return {"kind": "torque", "torques": torques, **_lease(message)}

    def _scale(self, group: str, message: SpeedScalingFactor) -> dict[str, Any]:
        self._mcs.group(group)
        return {"scale": message.factor}

    def _jog(self, group: str, message: JointJog) -> dict[str, Any]:
        joints, names = self._mcs.group(group).joints, list(message.joint_names)
        order, missing = joint_ranks(group, joints, names, Accepted(partial_joints=True))
        if len(message.velocities) != len(names):
            raise DataError(f"the jog has {len(message.velocities)} velocities for {len(names)} joints")
        velocities = ordered([*message.velocities, *([0.0] * len(missing))], order, joints, "velocity")
        return {"kind": "jog", "velocities": velocities, "lease_s": self._left_s(message.header)}

    def _twist(self, group: str, message: TwistStamped) -> dict[str, Any]:
        self._mcs.group(group)
        linear, angular = message.twist.linear, message.twist.angular
        velocities = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
        lease_s = self._left_s(message.header)
        return {"kind": "twist", "velocities": velocities, "frame": message.header.frame_id, "lease_s": lease_s}

    def _command(self, quantity: str, group: str, message: Float64MultiArray) -> dict[str, Any]:
        joints = self._mcs.group(group).joints
        values = ordered(list(message.data), range(len(joints)), joints, quantity)
        kind, field = _COMMANDS[quantity]
        lease_s = LONGEST_LEASE_S if quantity == "position" else self._timeout_s
        return {"kind": kind, field: values, "lease_s": lease_s}

    @property
    def _timeout_s(self) -> float:
        return float(self._mcs.node.get_parameter(_TIMEOUT).value)

    def _left_s(self, header: Header) -> float:
        """Time for which a jog still holds [s]; all of it where there is no stamp.

        Raises:
            DataError: It is too old, or has the stamp of another clock.
        """
        stamp_ns, timeout_s = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec, self._timeout_s
        age_s = 1e-9 * (int(self._mcs.client().snapshot()["stamp_ns"]) - stamp_ns) if stamp_ns else 0.0
        if not -timeout_s <= age_s < timeout_s:
            when = f"{age_s:.3f} s ago" if age_s > 0.0 else f"{-age_s:.3f} s ahead"
            raise DataError(f"the jog is stamped {when} of testbed time; {timeout_s:g} s are allowed ({_TIMEOUT})")
        return timeout_s - max(age_s, 0.0)

    def _order(self, group: str, message: SetpointCommand | TorqueCommand) -> tuple[list[int], tuple[str, ...]]:
        joints = self._mcs.group(group).joints
        return joint_order(group, joints, list(message.joints)), joints


def _lease(message: SetpointCommand | TorqueCommand) -> dict[str, Any]:
    return {"owner": message.owner, "lease_s": message.lease}
