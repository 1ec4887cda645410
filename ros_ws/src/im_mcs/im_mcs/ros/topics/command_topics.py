"""Topics for driving a layer, for the owner of the slots, and the speed of a group."""

from collections.abc import Callable
from functools import partial
from typing import Any

from control_msgs.msg import SpeedScalingFactor
from rclpy.qos import QoSProfile

from im_core.errors import ImError
from im_core.ros import qos
from im_mcs.client.points import joint_order, ordered
from im_mcs.client.servo_client import ServoReply
from im_mcs.ros.access import McsAccess
from im_mcs.state import Event
from im_msgs.msg import SetpointCommand, TorqueCommand

Translate = Callable[[str, Any], dict[str, Any]]
"""Arguments of a request from a group and a message."""


class CommandTopics:
    """``/<group>/command/setpoints`` and ``/<group>/command/torques`` of every group of every preset.

    ``/<group>/speed_scaling_input`` as with ros2_control's trajectory controller: the last message, also a latched one
    that comes late, is the share of the planned speed. It tells no sender: a group with an owner does not obey it.

    Args:
        access: MCS.
    """

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        for group in access.group_names:
            self._listen(SetpointCommand, group, "command/setpoints", Event.STREAM, self._setpoint)
            self._listen(TorqueCommand, group, "command/torques", Event.STREAM, self._torque)
            self._listen(SpeedScalingFactor, group, "speed_scaling_input", Event.SET_SPEED, self._scale, qos.LATCHED)

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
        def answer(reply: ServoReply) -> None:
            if reply.error is not None:
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

    def _order(self, group: str, message: SetpointCommand | TorqueCommand) -> tuple[list[int], tuple[str, ...]]:
        joints = self._mcs.group(group).joints
        return joint_order(group, joints, list(message.joints)), joints


def _lease(message: SetpointCommand | TorqueCommand) -> dict[str, Any]:
    return {"owner": message.owner, "lease_s": message.lease}
