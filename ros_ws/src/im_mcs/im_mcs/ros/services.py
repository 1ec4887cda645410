"""Services of MCS: of the state manager, on motions under way, and kinematic questions."""

from collections.abc import Awaitable, Callable
from typing import Any

from std_srvs.srv import Trigger

from im_core.errors import ImError
from im_core.ros.calls import run_in_thread
from im_core.ros.status import ok_status, to_status
from im_mcs.client.groups import best_positions, group_state
from im_mcs.client.points import ordered_points
from im_mcs.ros import messages
from im_mcs.ros.access import McsAccess
from im_mcs.state import Event
from im_msgs.msg import GroupState as GroupStateMessage
from im_msgs.srv import (
    CheckPath,
    ForwardKinematics,
    GetGroupState,
    GroupCommand,
    InverseKinematics,
    RenewLease,
    ReserveGroup,
    SetController,
    SetGripper,
    SetPartition,
    SetPayload,
    SetSpeed,
)

_TRIGGERS = (
    Event.POWER_ON,
    Event.POWER_OFF,
    Event.ENABLE_MOTION,
    Event.DISABLE_MOTION,
    Event.PROTECTIVE_STOP,
    Event.ESTOP,
    Event.RESET,
)
_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


class StateServices:
    """``/mcs/reserve``, ``take_over``, ``release``, ``renew``, ``set_partition``, and a ``std_srvs/Trigger`` an event.

    Args:
        access: MCS.
    """

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        access.node.create_service(ReserveGroup, "/mcs/reserve", answering(self._reserve))
        access.node.create_service(ReserveGroup, "/mcs/take_over", answering(self._take_over))
        access.node.create_service(ReserveGroup, "/mcs/release", answering(self._release))
        access.node.create_service(RenewLease, "/mcs/renew", answering(self._renew))
        access.node.create_service(SetPartition, "/mcs/set_partition", answering(self._set_partition))
        for event in _TRIGGERS:
            access.node.create_service(Trigger, f"/mcs/{event.value}", answering(self._on_trigger(event)))

    async def _reserve(self, request: ReserveGroup.Request, _: object, client: str) -> str:
        await self._mcs.request(Event.RESERVE, await self._reservation(request, client))
        return f"MCS is {self._mcs.state.value}"

    async def _take_over(self, request: ReserveGroup.Request, _: object, client: str) -> str:
        arguments = await self._reservation(request, client)
        results = await self._mcs.request(Event.TAKE_OVER, arguments)
        return self._mcs.take_overs.add(
            request.group, results["owner"], request.owner, arguments["sender"]["names"] or [client]
        )

    async def _release(self, request: ReserveGroup.Request, _: object, client: str) -> str:
        self._mcs.group(request.group)
        sender = await self._mcs.sender(client, request.owner)
        await self._mcs.request(Event.RELEASE, {"group": request.group, "sender": sender})
        return f"MCS is {self._mcs.state.value}"

    async def _reservation(self, request: ReserveGroup.Request, client: str) -> dict[str, Any]:
        self._mcs.group(request.group)
        messages.check_finite(lease=request.lease)
        sender = await self._mcs.sender(client)
        return {"group": request.group, "owner": request.owner, "lease_s": request.lease, "sender": sender}

    async def _renew(self, request: RenewLease.Request, *_: object) -> str:
        await self._mcs.request(Event.RENEW, {"owner": request.owner})
        return f"the lease of '{request.owner}' is renewed"

    async def _set_partition(self, request: SetPartition.Request, *_: object) -> str:
        await self._mcs.repartition(request.preset)
        return f"the groups are {', '.join(self._mcs.config.groups)}"

    def _on_trigger(self, event: Event) -> Callable[[Any, Any, str], Awaitable[str]]:
        async def work(*_: object) -> str:
            return await self._mcs.transition(event)

        return work


class MotionServices:
    """``/mcs/pause``, ``resume``, ``set_speed``, ``set_payload``, ``set_controller`` and ``set_gripper``.

    Args:
        access: MCS.
    """

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        access.node.create_service(GroupCommand, "/mcs/pause", answering(self._pause))
        access.node.create_service(GroupCommand, "/mcs/resume", answering(self._resume))
        access.node.create_service(SetSpeed, "/mcs/set_speed", answering(self._set_speed))
        access.node.create_service(SetPayload, "/mcs/set_payload", answering(self._set_payload))
        access.node.create_service(SetController, "/mcs/set_controller", answering(self._set_controller))
        access.node.create_service(SetGripper, "/mcs/set_gripper", answering(self._set_gripper))

    async def _pause(self, request: GroupCommand.Request, *_: object) -> str:
        """Anyone may: to stop is always allowed."""
        if request.group:
            self._mcs.group(request.group)
        await self._mcs.request(Event.PAUSE, {"group": request.group})
        return f"{request.group or 'every group'} pauses"

    async def _resume(self, request: GroupCommand.Request, _: object, client: str) -> str:
        if request.group:
            self._mcs.group(request.group)
        sender = await self._mcs.sender(client)
        await self._mcs.request(Event.RESUME, {"group": request.group, "sender": sender})
        return f"{request.group or 'every group'} goes on"

    async def _set_speed(self, request: SetSpeed.Request, _: object, client: str) -> str:
        self._mcs.group(request.group)
        messages.check_finite(scale=request.scale)
        arguments = {"group": request.group, "scale": request.scale, "sender": await self._mcs.sender(client)}
        await self._mcs.request(Event.SET_SPEED, arguments)
        return f"{request.group} moves at {request.scale:g} of the planned speed"

    async def _set_payload(self, request: SetPayload.Request, _: object, client: str) -> str:
        payload = request.payload
        center = {f"payload.com.{axis}": getattr(payload.com, axis) for axis in "xyz"}
        inertia = {f"payload.{name}": getattr(payload, name) for name in _INERTIA}
        self._mcs.group(request.group)
        messages.check_finite(**{"payload.m": payload.m, **center, **inertia})
        arguments = {
            "group": request.group,
            "mass": payload.m,
            "center": list(center.values()),
            "inertia": list(inertia.values()),
            "sender": await self._mcs.sender(client),
        }
        await self._mcs.request(Event.SET_PAYLOAD, arguments)
        return f"{request.group} carries {payload.m:g} kg"

    async def _set_controller(self, request: SetController.Request, _: object, client: str) -> str:
        self._mcs.group(request.group)
        sender = await self._mcs.sender(client)
        arguments = {"group": request.group, "controller": request.controller, "sender": sender}
        await self._mcs.request(Event.SET_CONTROLLER, arguments)
        return f"{request.controller} takes over {request.group}"

    async def _set_gripper(self, request: SetGripper.Request, response: SetGripper.Response, _: str) -> str:
        opening = 0.0 if request.close else self._mcs.cell.gripper.stroke
        messages.check_finite(force=request.force)
        arguments = {"gripper": request.gripper, "opening": opening, "force": request.force}
        results = await self._mcs.request(Event.SET_GRIPPER, arguments)
        response.opening = float(results["opening"])
        return ""


class KinematicsServices:
    """``/mcs/get_group_state``, ``forward_kinematics``, ``inverse_kinematics`` and ``check_path``.

    Args:
        access: MCS.
    """

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        access.node.create_service(GetGroupState, "/mcs/get_group_state", self._get_group_state)
        access.node.create_service(ForwardKinematics, "/mcs/forward_kinematics", self._forward_kinematics)
        access.node.create_service(InverseKinematics, "/mcs/inverse_kinematics", self._inverse_kinematics)
        access.node.create_service(CheckPath, "/mcs/check_path", self._check_path)

    def measured(self, group: str) -> GroupStateMessage:
        """Measured state of a group.

        Raises:
            StateError: MCS is unconfigured, or the group is one of another preset.
            NotFoundError: No such group.
        """
        mcs = self._mcs
        description, snapshot = mcs.group(group), mcs.client().snapshot()
        return messages.group_state(group_state(group, description, mcs.model, snapshot, mcs.config.servo.period_s))

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
        mcs = self._mcs
        try:
            mcs.group(request.group)
            q_all = best_positions(mcs.client().snapshot())
            wrist = await run_in_thread(mcs.node, mcs.kinematics.forward, request.group, list(request.q), q_all)
            response.success, response.status, response.wrist = True, ok_status(), messages.pose(wrist.pose)
        except ImError as error:
            response.success, response.status = False, to_status(error)
        return response

    async def _inverse_kinematics(
        self, request: InverseKinematics.Request, response: InverseKinematics.Response
    ) -> InverseKinematics.Response:
        mcs, p, o = self._mcs, request.wrist.position, request.wrist.orientation
        try:
            mcs.group(request.group)
            q_all = best_positions(mcs.client().snapshot())
            q = await run_in_thread(
                mcs.node,
                mcs.kinematics.inverse,
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
        mcs = self._mcs
        try:
            q_all = best_positions(mcs.client().snapshot())
            points = ordered_points(
                request.group,
                mcs.group(request.group).joints,
                list(request.path.joint_names),
                [list(point.positions) for point in request.path.points],
            )
            clearance = await run_in_thread(mcs.node, mcs.kinematics.check_path, request.group, points, q_all)
            response.success, response.status, response.clearance = True, ok_status(), clearance
        except ImError as error:
            response.success, response.status = False, to_status(error)
        return response


def answering(work: Callable[[Any, Any, str], Awaitable[str]]) -> Callable[[Any, Any], Callable[[str], Any]]:
    """A callback that says what ``work`` says, or why it could not be done.

    Args:
        work: Given request, response and the client that asks; it may fill what else the response has.
    """

    def serve(request: Any, response: Any) -> Callable[[str], Any]:
        async def answer(client: str) -> Any:
            try:
                response.message = await work(request, response, client)
                response.success = True
            except ImError as error:
                response.success, response.message = False, error.message
            return response

        return answer

    return serve
