"""Motions of groups on the way through the servo, and the goals of actions."""

import itertools
from collections import Counter
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from rclpy.action import CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from im_core.errors import ImError
from im_core.ros import qos
from im_core.ros.guard import GuardedActionServer
from im_core.ros.peers.client_identity import client_of
from im_mcs.client.servo_client import OnProgress
from im_mcs.protocol.requests import Policy
from im_mcs.ros import messages
from im_mcs.ros.access import McsAccess, Started
from im_mcs.ros.topics.path_markers import PathMarkers
from im_mcs.state import Event
from im_msgs.msg import GroupPath

_IN_FORCE = "0: the configuration's (servo.settle). In force from the next motion on."
_SETTLE = {
    "tolerance": (f"Largest mean error of each joint at rest [rad or m]; {_IN_FORCE}", 1.0),
    "still_tolerance": (f"The same of an arm held by friction, after half of timeout_s; {_IN_FORCE}", 1.0),
    "timeout_s": (f"Testbed time until an unsettled motion fails [s]; {_IN_FORCE}", 1000.0),
}


@dataclass(frozen=True)
class Arrival:
    """Arrival of a goal or a message: may reach the servo much later, after others.

    Attributes:
        group: What it is for.
        rank: The later it came, the larger.
        handle: The goal; None: a message.
    """

    group: str
    rank: int
    handle: ServerGoalHandle | None = None


class Motions:
    """Sender of MOVE requests; shows the followed path, and stops motions.

    Parameters: ``tolerance``, ``still_tolerance`` and ``timeout_s`` below ``settle``.
    """

    def __init__(self, access: McsAccess, markers: PathMarkers) -> None:
        self._mcs, self._markers = access, markers
        self._under_way: dict[int, Arrival] = {}
        self._ranks = itertools.count(1)
        self._replaced: Counter[str] = Counter()
        self._stopped: Counter[str] = Counter()
        groups, node = access.group_names, access.node
        for name, (what, largest) in _SETTLE.items():
            node.declared.declare(f"settle.{name}", 0.0, what, span=(0.0, largest), changeable=True)
        self._paths = {group: node.create_publisher(GroupPath, f"/{group}/path", qos.LATCHED) for group in groups}

    def arrive(self, group: str, handle: ServerGoalHandle | None = None) -> Arrival:
        """Return the arrival of a goal, or of a message, at the present moment."""
        return Arrival(group, next(self._ranks), handle)

    async def run(
        self,
        arrival: Arrival,
        arguments: dict[str, Any],
        client: str = "",
        started: Started | None = None,
        on_progress: OnProgress | None = None,
    ) -> dict[str, Any]:
        """Move a group and await the end.

        Args:
            arrival: When it came; what has been cancelled, stopped or replaced since is not sent to the servo.
            arguments: Of the MOVE request.
            client: Who asks for it, as :meth:`Goals.client` says; empty: who has said no name, as on a topic.
            started: Told the number of the request.
            on_progress: Told how far it is, in another thread.

        Raises:
            ImError: The motion is refused, or ended badly.
        """
        group = arrival.group
        shown: list[bool] = []
        numbers: list[int] = []

        def begin(number: int) -> None:
            numbers.append(number)
            self._under_way[number] = arrival
            if started is not None:
                started(number)

        def progress(*told: Any) -> None:
            with suppress(ImError):  # the servo may have ended since; then nobody needs to be told
                if not shown:
                    shown.append(True)
                    self._show(group, arguments["path"])
                if on_progress is not None:
                    on_progress(*told)

        try:
            settle = {name: self._mcs.node.get_parameter(f"settle.{name}").value for name in _SETTLE}
            sender = await self._mcs.sender(client)  # meanwhile a stop or a newer goal may come
            self._require_wanted(arrival)
            replaced = self._replaced[group]
            if arguments["policy"] == Policy.REPLACE:
                self._replaced[group] = arrival.rank
            try:
                asked = {**arguments, "settle": settle, "sender": sender}
                return await self._mcs.request(Event.MOVE, asked, begin, progress)
            except ImError:
                if not shown and self._replaced[group] == arrival.rank:
                    self._replaced[group] = replaced  # it was refused: what came before it may go on
                raise
        finally:
            for number in numbers:
                self._under_way.pop(number, None)
            if shown:
                self._paths[group].publish(GroupPath())
                self._markers.end(group)

    async def stop(self, arrival: Arrival) -> None:
        """Decelerate the motion of a group on the path, and end the motion and the waiting goals as cancelled.

        Args:
            arrival: When that was asked for; what came later goes on.

        Raises:
            ImError: The servo refuses.
        """
        group = arrival.group
        self._stopped[group] = max(self._stopped[group], arrival.rank)
        numbers = [n for n, other in self._under_way.items() if other.group == group and other.rank < arrival.rank]
        for number in reversed(numbers):  # what waits first: it shall not begin
            try:
                await self._mcs.request(Event.CANCEL, {"goal": number})
            except ImError:
                if number in self._under_way:  # else it ended by itself meanwhile
                    raise

    def _require_wanted(self, arrival: Arrival) -> None:
        group = arrival.group
        require_wanted(arrival.handle)
        if arrival.rank < self._stopped[group]:
            raise ImError(f"group '{group}': stopped before the motion began", code="cancelled", group=group)
        if arrival.rank < self._replaced[group]:
            raise ImError(f"group '{group}': replaced by a newer goal", code="replaced", group=group)

    def _show(self, group: str, path: dict[str, Any]) -> None:
        stamp_ns = int(self._mcs.client().snapshot()["stamp_ns"])
        joints = self._mcs.lead_joints(group) if path["kind"] == "line" else self._mcs.config.groups[group].joints
        self._paths[group].publish(messages.group_path(joints, path, stamp_ns))
        self._markers.begin(group, path)


class CalledActionServer(GuardedActionServer):
    """Action server with the client of each goal: ``clients``, by the number of the goal, until the end."""

    def __init__(self, *args: Any, **options: Any) -> None:
        self.clients: dict[bytes, str] = {}
        super().__init__(*args, **options)

    async def _execute_goal_request(self, request_header_and_message: tuple[Any, Any]) -> None:
        header, request = request_header_and_message
        goal = bytes(request.goal_id.uuid)
        if goal not in self._goal_handles:  # one that has that number keeps its sender
            self.clients[goal] = client_of(header)
        await super()._execute_goal_request(request_header_and_message)


class Goals:
    """Actions, and the numbers of requests by goal, so a cancelled goal decelerates."""

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        self._numbers: dict[bytes, int] = {}
        self._servers: list[CalledActionServer] = []

    def serve(self, action: type, name: str, execute: Callable[[ServerGoalHandle], Awaitable[Any]]) -> None:
        """Offer an action with all goals accepted: an impossible one ends at once, with the reason in the result."""
        server = CalledActionServer(
            self._mcs.node,
            action,
            name,
            execute_callback=execute,
            goal_callback=lambda _: GoalResponse.ACCEPT,
            cancel_callback=self._cancel,
        )
        self._servers.append(server)

    def client(self, handle: ServerGoalHandle) -> str:
        """Return the sender of a goal, as :func:`im_core.ros.peers.client_identity.client_of` says."""
        goal = bytes(handle.goal_id.uuid)
        return next((server.clients[goal] for server in self._servers if goal in server.clients), "")

    def begin_goal(self, handle: ServerGoalHandle, number: int) -> None:
        """The servo knows the goal by ``number``."""
        self._numbers[bytes(handle.goal_id.uuid)] = number

    def end_goal(self, handle: ServerGoalHandle) -> None:
        """The goal has ended."""
        goal = bytes(handle.goal_id.uuid)
        self._numbers.pop(goal, None)
        for server in self._servers:
            server.clients.pop(goal, None)

    def _cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        """Callback of an action server: the motion decelerates on the path and ends as cancelled."""
        number = self._numbers.get(bytes(handle.goal_id.uuid))
        if number is None:
            return CancelResponse.ACCEPT  # the servo has not been asked yet, and will not be: see require_wanted
        try:
            self._mcs.client().send(Event.CANCEL, {"goal": number})
        except ImError as error:
            self._mcs.node.get_logger().warning(error.message)
            return CancelResponse.REJECT
        return CancelResponse.ACCEPT


def require_wanted(handle: ServerGoalHandle | None) -> None:
    """Look, immediately before the servo is asked, whether a goal is to be cancelled; None: there is no goal.

    Raises:
        ImError: It is (code ``cancelled``).
    """
    if handle is not None and handle.is_cancel_requested:
        raise ImError("the goal was cancelled before it began", code="cancelled")


def fail(handle: ServerGoalHandle, error: ImError) -> None:
    """End a failed goal: cancelled where so requested, else aborted."""
    if error.code == "cancelled" and handle.is_cancel_requested:
        handle.canceled()
    else:
        handle.abort()
