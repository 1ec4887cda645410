"""Topics for driving a layer, for the owner of the slots."""

from collections.abc import Callable
from functools import partial
from typing import Any

from im_core.errors import ImError
from im_core.ros import qos
from im_mcs.client.points import joint_order, ordered
from im_mcs.client.servo_client import ServoReply
from im_mcs.ros.access import McsAccess
from im_mcs.state import Event
from im_msgs.msg import SetpointCommand, TorqueCommand


class CommandTopics:
    """``/<group>/command/setpoints`` and ``/<group>/command/torques`` of every group of every preset.

    Args:
        access: MCS.
    """

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        for group in access.group_names:
            self._listen(SetpointCommand, group, "setpoints", self._setpoint)
            self._listen(TorqueCommand, group, "torques", self._torque)

    def _listen(self, message_type: type, group: str, name: str, translate: Callable[..., dict[str, Any]]) -> None:
        topic = f"/{group}/command/{name}"
        take = partial(self._take, group, topic, translate)
        self._mcs.node.create_subscription(message_type, topic, take, qos.EVENTS)

    def _take(self, group: str, topic: str, translate: Callable[..., dict[str, Any]], message: Any) -> None:
        def answer(reply: ServoReply) -> None:
            if reply.error is not None:
                self._mcs.refusals.add(topic, reply.error)

        try:
            self._mcs.check(message)
            joints = self._mcs.group(group).joints
            order = joint_order(group, joints, list(message.joints))
            arguments = {"group": group, "owner": message.owner, "lease_s": message.lease}
            arguments.update(translate(message, order, joints))
            self._mcs.client().send(Event.STREAM, arguments, answer)
        except ImError as error:
            self._mcs.refusals.add(topic, error)

    @staticmethod
    def _setpoint(message: SetpointCommand, order: list[int], joints: tuple[str, ...]) -> dict[str, Any]:
        positions = ordered(message.position, order, joints, "position")
        velocities = ordered(message.velocity, order, joints, "velocity") if message.velocity else []
        return {"kind": "setpoint", "positions": positions, "velocities": velocities}

    @staticmethod
    def _torque(message: TorqueCommand, order: list[int], joints: tuple[str, ...]) -> dict[str, Any]:
        return {"kind": "torque", "torques": ordered(message.torque, order, joints, "torque")}
