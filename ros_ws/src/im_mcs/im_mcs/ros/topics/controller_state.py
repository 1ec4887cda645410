"""``/<group>/controller_state``, like the topic of ros2_control's joint trajectory controller."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from control_msgs.msg import JointTrajectoryControllerState
from trajectory_msgs.msg import JointTrajectoryPoint

from im_core.ros import qos
from im_core.ros.messages.stamps import to_stamp
from im_mcs.ros.access import McsAccess
from im_mcs.ros.messages import duration

_RATE = "controller_state_rate"
_LEAST_HZ, _USUAL_HZ, _MOST_HZ = 0.1, 50.0, 250.0
_DESCRIPTION = (
    "How often /<group>/controller_state is published, by testbed time [1/s]; what nobody listens to is not, "
    "and no more than joint_state_rate says. In force at once."
)

Sample = dict[str, Any]


class ControllerStates:
    """``/<group>/controller_state`` of every group of every preset; published for the groups in force.

    Parameter: ``controller_state_rate`` [1/s], up to 250.
    """

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        access.node.declared.declare(_RATE, _USUAL_HZ, _DESCRIPTION, span=(_LEAST_HZ, _MOST_HZ), changeable=True)
        self._publishers = {
            group: access.node.create_publisher(
                JointTrajectoryControllerState, f"/{group}/controller_state", qos.EVENTS
            )
            for group in access.group_names
        }
        self._told_ns = -1

    def publish(self, samples: Sequence[Sample], speeds: Callable[[], Mapping[str, float]]) -> None:
        """Publish the due samples of the servo.

        Args:
            samples: Since the last call, in the order of time.
            speeds: Gives the rate in force of each group: 1 as planned, 0 halted.
        """
        listened = [group for group in self._mcs.config.groups if self._publishers[group].get_subscription_count()]
        due = [sample for sample in samples if self._is_due(int(sample["stamp_ns"]))] if listened else []
        if not due:
            return
        in_force = speeds()
        for sample in due:
            for group in listened:
                self._publishers[group].publish(self._message(group, sample, in_force[group]))

    def _is_due(self, stamp_ns: int) -> bool:
        """Return whether a sample is due; the same sample once more is, where time stands still."""
        period_ns = round(1e9 / float(self._mcs.node.get_parameter(_RATE).value))
        due = self._told_ns == stamp_ns or self._told_ns // period_ns != stamp_ns // period_ns
        if due:
            self._told_ns = stamp_ns
        return due

    def _message(self, group: str, sample: Sample, speed: float) -> JointTrajectoryControllerState:
        description = self._mcs.config.groups[group]
        index = self._mcs.index(description).tolist()
        q, v, a, measured_q, measured_v, tau = (
            [sample[name][i] for i in index] for name in ("setpoint_q", "setpoint_v", "setpoint_a", "q", "v", "tau")
        )
        message = JointTrajectoryControllerState(joint_names=list(description.joints), speed_scaling_factor=speed)
        message.header.stamp = to_stamp(sample["stamp_ns"])
        message.reference = JointTrajectoryPoint(positions=q, velocities=v, accelerations=a)
        message.feedback = JointTrajectoryPoint(positions=measured_q, velocities=measured_v)
        message.error = JointTrajectoryPoint(positions=_less(q, measured_q), velocities=_less(v, measured_v))
        message.output = JointTrajectoryPoint(effort=tau)
        place_s, since_s = sample["place_s"][index[0]], sample["since_s"][index[0]]
        times = (place_s, since_s, place_s - since_s)
        for point, seconds in zip((message.reference, message.feedback, message.error), times, strict=True):
            point.time_from_start = duration(seconds)
        return message


def _less(wanted: Sequence[float], measured: Sequence[float]) -> list[float]:
    return [a - b for a, b in zip(wanted, measured, strict=True)]
