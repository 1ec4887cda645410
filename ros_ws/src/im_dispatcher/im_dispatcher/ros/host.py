"""Node seen from commands: data objects are plain values inside, and messages outside."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from geometry_msgs.msg import PoseStamped
from std_msgs.msg import String

from im_core.bounded_json import read_json
from im_core.ros import qos
from im_dispatcher.poses_file import PosesFile, WristPose
from im_dispatcher.report import SkippedPose, SolverReport, StepTimes
from im_msgs.msg import CalibrationReport, Firing, Rejection
from im_pnt.model.net import Net
from im_pnt_node.rerun.host import Host
from im_pnt_node.ros.node import PntNode

ValueT = TypeVar("ValueT")


class DispatcherHost:
    """Host of commands (:class:`im_dispatcher.command.CommandHost`), given before the node exists and used afterwards.

    Args:
        host: The node, or what stands for it.
    """

    def __init__(self, host: Host) -> None:
        self._host, self.seed = host, 0
        self._timed: list[tuple[str, StepTimes]] = []

    def attach(self, node: PntNode) -> None:
        """Set the node behind the host."""
        self._node, self.seed = node, node.seed
        node.create_subscription(Firing, "/pnt/firings", self._note_firing, qos.EVENTS)

    @property
    def recorded(self) -> bool:
        """Whether the mission is being recorded."""
        return self._host.recorded

    async def put_object(self, name: str, value: object, place: str = "") -> None:
        """Store a data object of a type in :data:`MESSAGES`."""
        await self._host.dom.put(name, MESSAGES[type(value)](value), place)

    async def get_object(self, name: str, kind: type[ValueT]) -> ValueT:
        """Return a data object as a value of a type in :data:`VALUES`."""
        message_type, value_of = VALUES[kind]
        value: ValueT = value_of(await self._host.dom.get(name, message_type))
        return value

    def noted(self, key: str, compute: Callable[[], ValueT]) -> ValueT:
        """Return a value computed from the world outside."""
        return self._host.noted(key, compute)

    async def noted_apart(self, key: str, compute: Callable[..., ValueT], *arguments: object) -> ValueT:
        """Return a value computed from the world outside, in a separate thread."""
        return await self._host.noted_apart(key, compute, *arguments)

    def time_steps(self, net: str, times: StepTimes) -> None:
        """Time the firings of a net, and of all nets required by the net."""
        self._timed.append((net, times))

    def nets_for(self, net: str) -> Sequence[Net]:
        """Return a net as written, with all required nets."""
        return self._node.net_with_servers(net)

    def now(self) -> float:
        """Return the testbed time [s]."""
        return float(self._node.get_clock().now().nanoseconds) * 1e-9

    def warn(self, text: str) -> None:
        """Write a line to the log."""
        self._host.warn(text)

    def _note_firing(self, message: Firing) -> None:
        if not 0.0 <= message.duration < math.inf:
            return  # no node of ours says that, and JSON cannot carry a number that is none
        name = f"{message.net}.{message.transition}"
        stamp = message.stamp.sec + message.stamp.nanosec * 1e-9
        for net, times in self._timed:
            if name not in times.steps and not self._is_step(net, message):
                continue
            if message.phase == Firing.START:
                times.note_start(name, message.command_id, stamp)
            elif message.phase in (Firing.END, Firing.FAILED):
                times.note_end(name, message.command_id, stamp, message.duration)

    def _is_step(self, net: str, message: Firing) -> bool:
        """Return whether a transition belongs to a net or a required net: firings come from any sender."""
        nets = self.nets_for(net) if net in self._node.exchange.nets else ()
        return any(each.name == message.net and message.transition in each.transitions for each in nets)


def _stamped(pose: WristPose) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = "world"
    position, orientation = message.pose.position, message.pose.orientation
    position.x, position.y, position.z = pose.position_m
    orientation.x, orientation.y, orientation.z, orientation.w = pose.orientation_xyzw
    return message


#: The messages of values that commands put; a dictionary is JSON data.
MESSAGES: Mapping[type, Callable[[Any], object]] = {
    dict: lambda data: String(data=json.dumps(data)),
    WristPose: _stamped,
    PosesFile: lambda file: String(data=file.model_dump_json()),
    SkippedPose: lambda skipped: Rejection(pose=skipped.pose, reason=skipped.reason),
}

POSES, REPORT = "the poses of the calibration", "the report of the calibration"

#: The values of messages that commands get.
VALUES: Mapping[type, tuple[type, Callable[[Any], Any]]] = {
    dict: (String, lambda message: read_json(dict[str, object], message.data, "a data object")),
    PosesFile: (String, lambda message: read_json(PosesFile, message.data, POSES)),
    SkippedPose: (Rejection, lambda message: SkippedPose(message.pose, message.reason)),
    SolverReport: (CalibrationReport, lambda message: SolverReport(read_json(dict[str, object], message.json, REPORT))),
}
