"""Services that answer without moving anything and without letting testbed time pass."""

from typing import TYPE_CHECKING

from im_core.errors import ImError
from im_core.ros.calls import run_in_thread
from im_core.ros.status import ok_status, to_status
from im_mcs.client.group_state import best_positions, group_state
from im_mcs.client.points import ordered_points
from im_mcs.ros import messages
from im_msgs.msg import GroupState as GroupStateMessage
from im_msgs.srv import CheckPath, ForwardKinematics, GetGroupState, InverseKinematics

if TYPE_CHECKING:
    from im_mcs.ros.node import McsNode


class KinematicsServices:
    """``/mcs/get_group_state``, ``forward_kinematics``, ``inverse_kinematics`` and ``check_path``.

    Args:
        node: The node that offers them.
    """

    def __init__(self, node: "McsNode") -> None:
        self._node = node
        node.create_service(GetGroupState, "/mcs/get_group_state", self._get_group_state)
        node.create_service(ForwardKinematics, "/mcs/forward_kinematics", self._forward_kinematics)
        node.create_service(InverseKinematics, "/mcs/inverse_kinematics", self._inverse_kinematics)
        node.create_service(CheckPath, "/mcs/check_path", self._check_path)

    def measured(self, group: str) -> GroupStateMessage:
        """Measured state of a group.

        Raises:
            StateError: MCS is unconfigured, or the group is one of another preset.
            NotFoundError: No such group.
        """
        node = self._node
        description, snapshot = node.group(group), node.client().snapshot()
        return messages.group_state(group_state(group, description, node.model, snapshot, node.config.servo.period_s))

    def _get_group_state(
        self, request: GetGroupState.Request, response: GetGroupState.Response
    ) -> GetGroupState.Response:
        try:
            response.state = self.measured(request.group)
            response.success, response.status = True, ok_status()
        except ImError as error:
            response.success, response.status = False, to_status(error)
        return response

    async def _forward_kinematics(
        self, request: ForwardKinematics.Request, response: ForwardKinematics.Response
    ) -> ForwardKinematics.Response:
        node = self._node
        try:
            node.group(request.group)
            q_all = best_positions(node.client().snapshot())
            wrist = await run_in_thread(node, node.kinematics.forward, request.group, list(request.q), q_all)
            response.success, response.status, response.wrist = True, ok_status(), messages.pose(wrist.pose)
        except ImError as error:
            response.success, response.status = False, to_status(error)
        return response

    async def _inverse_kinematics(
        self, request: InverseKinematics.Request, response: InverseKinematics.Response
    ) -> InverseKinematics.Response:
        node, p, o = self._node, request.wrist.position, request.wrist.orientation
        try:
            node.group(request.group)
            q_all = best_positions(node.client().snapshot())
            q = await run_in_thread(
                node,
                node.kinematics.inverse,
                request.group,
                (p.x, p.y, p.z),
                (o.x, o.y, o.z, o.w),
                list(request.seed),
                q_all,
                request.avoid_collisions,
            )
            response.success, response.status, response.q = True, ok_status(), q.tolist()
        except ImError as error:
            response.success, response.status = False, to_status(error)
        return response

    async def _check_path(self, request: CheckPath.Request, response: CheckPath.Response) -> CheckPath.Response:
        node = self._node
        try:
            q_all = best_positions(node.client().snapshot())
            points = ordered_points(
                request.group,
                node.group(request.group).joints,
                list(request.path.joint_names),
                [list(point.positions) for point in request.path.points],
            )
            clearance = await run_in_thread(node, node.kinematics.check_path, request.group, points, q_all)
            response.success, response.status, response.clearance = True, ok_status(), clearance
        except ImError as error:
            response.success, response.status = False, to_status(error)
        return response
