"""Goals of actions and the motions in the servo that they stand for."""

from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from im_core.errors import ImError
from im_mcs.state import Event

if TYPE_CHECKING:
    from im_mcs.ros.node import McsNode


class Goals:
    """Actions, and the numbers of requests by goal, so that a cancelled goal decelerates.

    Args:
        node: The node that offers the actions.
    """

    def __init__(self, node: "McsNode") -> None:
        self._node = node
        self._numbers: dict[bytes, int] = {}
        self._servers: list[ActionServer] = []

    def serve(self, action: type, name: str, execute: Callable[[ServerGoalHandle], Awaitable[Any]]) -> None:
        """Offer an action whose goals are all accepted: what cannot be done ends at once, and its result says why."""
        server = ActionServer(
            self._node,
            action,
            name,
            execute_callback=execute,
            goal_callback=lambda _: GoalResponse.ACCEPT,
            cancel_callback=self._cancel,
        )
        self._servers.append(server)

    def begin(self, handle: ServerGoalHandle, number: int) -> None:
        """The servo knows the goal by ``number``."""
        self._numbers[bytes(handle.goal_id.uuid)] = number

    def end(self, handle: ServerGoalHandle) -> None:
        """The goal has ended."""
        self._numbers.pop(bytes(handle.goal_id.uuid), None)

    def _cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        """Callback of an action server: the motion decelerates on its path and ends as cancelled."""
        number = self._numbers.get(bytes(handle.goal_id.uuid))
        if number is None:
            return CancelResponse.REJECT
        try:
            self._node.client().send(Event.CANCEL, {"goal": number})
        except ImError as error:
            self._node.get_logger().warning(error.message)
            return CancelResponse.REJECT
        return CancelResponse.ACCEPT


def fail(handle: ServerGoalHandle, error: ImError) -> None:
    """End a goal that did not succeed: cancelled where that was asked for, else aborted."""
    if error.code == "cancelled" and handle.is_cancel_requested:
        handle.canceled()
    else:
        handle.abort()
