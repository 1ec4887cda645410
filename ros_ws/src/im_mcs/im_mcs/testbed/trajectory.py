"""Channel driver of a robot that has its vendor's trajectory controller alone: MCS plans, the vendor follows."""

from collections.abc import Mapping, Sequence

from im_core.errors import ConfigError
from im_mcs.limits.slots import Interface
from im_mcs.testbed.driver import PlannedCourse
from im_mcs.testbed.joint_state import JointStateDriver, SpeedTopic, checked_topic


class TrajectoryDriver(JointStateDriver):
    """Positions from a topic of joint states, courses to an action ``control_msgs/action/FollowJointTrajectory``.

    A motion is one goal. Where its rate changes, as in a pause or a stop on the path, a goal with the rest of the
    motion takes over, which begins where the one before would be then. An emergency stop cancels. Goals have no
    tolerances: the vendor's hold. A goal that is refused, or that ends otherwise than at its end, and an action with no
    server or several, are faults. The goal runs ``delay_s`` after the setpoints, for which the bound of the following
    error needs room.

    Args:
        instance: Which machine on this host.
        timeout_s: As of :class:`~im_mcs.testbed.joint_state.JointStateDriver`.
        interfaces: Kinds of commands by channel: positions.
        joints: Names, in the order of the channels; of all joints of the controller.
        state_topic: Positions, from the robot.
        action: Name of the action.
        delay_s: Time for a goal to arrive, by clocks that agree [s]; 0: it begins when it arrives.
        speed: Fields of :class:`~im_mcs.testbed.joint_state.SpeedTopic`, of a robot that may follow slower than it is
            asked to: MCS goes along.
        period_s: Time between ticks [s].
        silence_s: A reading older than this is a fault [s].
        faults: As of :class:`~im_mcs.testbed.joint_state.JointStateDriver`.

    Raises:
        ConfigError: As of :class:`~im_mcs.testbed.joint_state.JointStateDriver`; or ``delay_s`` is negative.
        LinkError: The robot, or the process, is silent; names topic, joints and seconds.
    """

    interfaces_taken: tuple[Interface, ...] = ("position",)
    bridge = "im_mcs.ros.trajectory_channels"
    points = 2000

    def __init__(
        self,
        instance: str,
        timeout_s: float,
        interfaces: Mapping[int, Interface],
        joints: Sequence[str],
        state_topic: str,
        action: str,
        delay_s: float = 0.1,
        speed: Mapping[str, object] | None = None,
        period_s: float = 0.0045,
        silence_s: float = 0.1,
        faults: Sequence[Mapping[str, object]] = (),
    ) -> None:
        if not delay_s >= 0.0:
            raise ConfigError(f"delay_s of the driver of action '{action}' is {delay_s}, not >= 0 [s]")
        told = f"speed of the driver of action '{action}'"
        self._scaling = None if speed is None else checked_topic(SpeedTopic, speed, told).model_dump()
        self._delay_s, self._number = delay_s, 0
        super().__init__(instance, timeout_s, interfaces, joints, state_topic, action, period_s, silence_s, faults)

    def encoding(self, interfaces: Mapping[int, Interface]) -> dict[str, object]:
        """Return the delay of goals, and the topic of the speed."""
        return {"delay_s": self._delay_s, "speed": self._scaling}

    @property
    def speed(self) -> float:
        """Share of the wanted speed with which the robot follows, 0 to 1; 1 if it does not tell."""
        return float(self._link.received.read()["speed"])

    def follow(self, course: PlannedCourse) -> None:
        """Send a goal, unless no joint is driven."""
        self._number += 1
        record, count = self._link.course.record(), len(course.seconds)
        record["number"], record["count"] = self._number, count
        record["seconds"][:count], record["q"][:count], record["v"][:count] = course
        self._link.course.write(record)
        self._link.bell.post()
