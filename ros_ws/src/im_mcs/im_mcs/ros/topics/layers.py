"""Topics showing each layer; a topic without a subscriber is not published."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import Wrench, WrenchStamped
from rclpy.publisher import Publisher

from im_core.errors import StateError
from im_core.ros import qos
from im_core.ros.messages.stamps import to_stamp
from im_mcs.ros.access import McsAccess
from im_msgs.msg import GroupSetpoints, GroupTorques, SlotStates

Sample = dict[str, Any]


class Layers:
    """``/mcs/slots``, ``/<wrist>/wrench``, ``/<group>/setpoints`` and ``/<group>/torques``.

    Attributes:
        wrists: Frames of the force-torque sensors.
    """

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        self._names = list(access.model.names)
        self._drivers = [access.config.testbed.drivers[slot.driver].driver for slot in access.config.joint_slots]
        self._grippers = [slot.name for slot in access.config.gripper_slots]
        tips = access.cell.devices("force")
        self.wrists = [tips[slot.name] for slot in access.config.wrench_slots]
        self._zero = np.zeros((len(self.wrists), 6))
        self._newest: Sequence[Sample] = ()
        self._slots = access.node.create_publisher(SlotStates, "/mcs/slots", qos.EVENTS)
        self._wrenches = [
            access.node.create_publisher(WrenchStamped, f"/{wrist}/wrench", qos.EVENTS) for wrist in self.wrists
        ]
        self._torques = self._per_group(GroupTorques, "torques")
        self._setpoints = self._per_group(GroupSetpoints, "setpoints")

    def publish(self, samples: Sequence[Sample], laws: Callable[[], dict[str, str]]) -> None:
        """Show samples of the servo.

        Args:
            samples: Since the last call, in the order of time.
            laws: Gives the control law in force of each group.
        """
        if not samples:
            return
        self._newest = samples
        if self._slots.get_subscription_count():
            self._slots.publish(self._slot_states(samples[-1]))
        for rank, publisher in enumerate(self._wrenches):
            if publisher.get_subscription_count():
                for sample in samples:
                    publisher.publish(self._wrench(rank, sample))
        listened = [g for g in self._mcs.config.groups if self._torques[g].get_subscription_count()]
        in_force = laws() if listened else {}
        for group in listened:
            for sample in samples:
                self._torques[group].publish(self._group_torques(group, sample, in_force[group]))
        for group in self._mcs.config.groups:
            if self._setpoints[group].get_subscription_count():
                for sample in samples:
                    self._setpoints[group].publish(self._group_setpoints(group, sample))

    def _per_group(self, message_type: type, name: str) -> dict[str, Publisher]:
        mcs = self._mcs
        return {g: mcs.node.create_publisher(message_type, f"/{g}/{name}", qos.EVENTS) for g in mcs.group_names}

    def _slot_states(self, sample: Sample) -> SlotStates:
        return SlotStates(
            stamp=to_stamp(sample["stamp_ns"]),
            tick=sample["tick"],
            joints=self._names,
            drivers=self._drivers,
            position=sample["q"],
            velocity=sample["v"],
            torque=sample["tau"],
            age=sample["age"],
            brakes=sample["brakes"],
            grippers=self._grippers,
            opening=sample["gripper"],
            grip_force=sample["gripper_force"],
            wrists=self.wrists,
            wrenches=[_fill(Wrench(), values) for values in sample["wrench"]],
        )

    async def tare(self, wrist: str, *_: object) -> str:
        """Let ``/<wrist>/wrench`` count from the present reading on; slots show the reading as it is.

        Raises:
            StateError: There is no reading.
        """
        rank = self.wrists.index(wrist)
        rows = [sample["wrench"][rank] for sample in self._newest]
        if not rows or not np.isfinite(rows).all():
            raise StateError(f"the force sensor of {wrist} gives no reading", frame=wrist)
        self._zero[rank] = np.mean(rows, axis=0)
        force = ", ".join(f"{value:.2f}" for value in self._zero[rank, :3])
        return f"/{wrist}/wrench is zero now; the sensor's force is ({force}) N"

    def _wrench(self, rank: int, sample: Sample) -> WrenchStamped:
        message = WrenchStamped()
        message.header.stamp, message.header.frame_id = to_stamp(sample["stamp_ns"]), self.wrists[rank]
        _fill(message.wrench, (np.asarray(sample["wrench"][rank]) - self._zero[rank]).tolist())
        return message

    def _group_torques(self, group: str, sample: Sample, law: str) -> GroupTorques:
        joints, index = self._joints(group)
        tau = [sample["tau"][i] for i in index]
        return GroupTorques(stamp=to_stamp(sample["stamp_ns"]), controller=law, joints=joints, torque=tau)

    def _group_setpoints(self, group: str, sample: Sample) -> GroupSetpoints:
        joints, index = self._joints(group)
        q, v, a = ([sample[f"setpoint_{name}"][i] for i in index] for name in "qva")
        return GroupSetpoints(stamp=to_stamp(sample["stamp_ns"]), joints=joints, position=q, velocity=v, acceleration=a)

    def _joints(self, group: str) -> tuple[list[str], list[int]]:
        description = self._mcs.config.groups[group]
        return list(description.joints), self._mcs.index(description).tolist()


def _fill(message: Wrench, values: Sequence[float]) -> Wrench:
    message.force.x, message.force.y, message.force.z = values[:3]
    message.torque.x, message.torque.y, message.torque.z = values[3:]
    return message
