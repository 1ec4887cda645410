"""Actions that move groups."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from im_core.errors import ImError
from im_core.ros.status import ok_status, to_status
from im_mcs.client.group_state import group_state
from im_mcs.client.points import ordered_points
from im_mcs.client.requests import check_path, check_speed_scale
from im_mcs.limits import JointLimits
from im_mcs.ros import messages
from im_mcs.state import Event
from im_msgs.action import Move

if TYPE_CHECKING:
    from im_mcs.ros.node import McsNode


class MotionServer:
    """``/<group>/move`` of every group.

    Every goal is accepted; what cannot be done ends at once with a status that says why.

    Args:
        node: The node that offers them.
    """

    def __init__(self, node: "McsNode") -> None:
        self._node = node
        self._limits = JointLimits(node.model, node.config.limits)
        self._numbers: dict[bytes, int] = {}
        self._servers = [
            ActionServer(
                node,
                Move,
                f"/{group}/move",
                execute_callback=partial(self._execute, group),
                goal_callback=lambda _: GoalResponse.ACCEPT,
                cancel_callback=self._cancel,
            )
            for group in node.config.groups
        ]

    async def _execute(self, group: str, handle: ServerGoalHandle) -> Move.Result:
        result = Move.Result()
        key = bytes(handle.goal_id.uuid)
        try:
            arguments = self._arguments(group, handle.request)
            results = await self._node.request(
                Event.MOVE,
                arguments,
                started=lambda number: self._numbers.__setitem__(key, number),
                on_progress=partial(self._feedback, handle),
            )
        except ImError as error:
            result.success, result.status = False, to_status(error)
            if error.code == "cancelled" and handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
        else:
            result.success, result.status = True, ok_status()
            result.duration = float(results["duration"])
            handle.succeed()
        finally:
            self._numbers.pop(key, None)
        self._add_state(group, result)
        return result

    def _arguments(self, group: str, goal: Move.Goal) -> dict[str, object]:
        """Arguments of the request, checked here first: what is not finite does not travel."""
        self._node.client()
        joints = self._node.config.groups[group].joints
        points = ordered_points(
            group, joints, list(goal.path.joint_names), [list(point.positions) for point in goal.path.points]
        )
        index = np.array([self._node.model.index(joint) for joint in joints], dtype=np.intp)
        check_path(self._limits, index, points, self._node.config.planning.max_points)
        return {"group": group, "points": points, "speed_scale": check_speed_scale(goal.speed_scale)}

    def _add_state(self, group: str, result: Move.Result) -> None:
        try:
            snapshot = self._node.client().snapshot()
        except ImError:
            return  # unconfigured: the result's status says so
        description = self._node.config.groups[group]
        period_s = self._node.config.servo.period_s
        result.state = messages.group_state(group_state(group, description, self._node.model, snapshot, period_s))

    def _feedback(self, handle: ServerGoalHandle, progress: float, point: int) -> None:
        message = Move.Feedback(progress=progress, point=point)
        message.stamp = messages.time(int(self._node.client().snapshot()["stamp_ns"]))
        handle.publish_feedback(message)

    def _cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        number = self._numbers.get(bytes(handle.goal_id.uuid))
        if number is None:
            return CancelResponse.REJECT
        self._node.client().send(Event.CANCEL, {"goal": number})
        return CancelResponse.ACCEPT
