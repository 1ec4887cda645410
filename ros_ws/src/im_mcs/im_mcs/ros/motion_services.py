"""Services that act on motions under way, on what a group carries and on its control law."""

from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

from im_mcs.ros import messages
from im_mcs.ros.serving import serving
from im_mcs.state import Event
from im_msgs.srv import GroupCommand, SetController, SetGripper, SetPayload, SetSpeed

if TYPE_CHECKING:
    from im_mcs.ros.node import McsNode

_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


class MotionServices:
    """``/mcs/pause``, ``resume``, ``set_speed``, ``set_payload``, ``set_controller`` and ``set_gripper``.

    Args:
        node: The node that offers them.
    """

    def __init__(self, node: "McsNode") -> None:
        self._node = node
        node.create_service(GroupCommand, "/mcs/pause", serving(self._on_group(Event.PAUSE, "pauses")))
        node.create_service(GroupCommand, "/mcs/resume", serving(self._on_group(Event.RESUME, "goes on")))
        node.create_service(SetSpeed, "/mcs/set_speed", serving(self._set_speed))
        node.create_service(SetPayload, "/mcs/set_payload", serving(self._set_payload))
        node.create_service(SetController, "/mcs/set_controller", serving(self._set_controller))
        node.create_service(SetGripper, "/mcs/set_gripper", serving(self._set_gripper))

    def _on_group(self, event: Event, verb: str) -> Callable[[Any, Any], Awaitable[str]]:
        async def work(request: GroupCommand.Request, _: object) -> str:
            if request.group:
                self._node.group(request.group)
            await self._node.request(event, {"group": request.group})
            return f"{request.group or 'every group'} {verb}"

        return work

    async def _set_speed(self, request: SetSpeed.Request, _: object) -> str:
        self._node.group(request.group)
        messages.check_finite(scale=request.scale)
        await self._node.request(Event.SET_SPEED, {"group": request.group, "scale": request.scale})
        return f"{request.group} moves at {request.scale:g} of the planned speed"

    async def _set_payload(self, request: SetPayload.Request, _: object) -> str:
        payload = request.payload
        center = {f"payload.com.{axis}": getattr(payload.com, axis) for axis in "xyz"}
        inertia = {f"payload.{name}": getattr(payload, name) for name in _INERTIA}
        self._node.group(request.group)
        messages.check_finite(**{"payload.m": payload.m, **center, **inertia})
        arguments = {
            "group": request.group,
            "mass": payload.m,
            "center": list(center.values()),
            "inertia": list(inertia.values()),
        }
        await self._node.request(Event.SET_PAYLOAD, arguments)
        return f"{request.group} carries {payload.m:g} kg"

    async def _set_controller(self, request: SetController.Request, _: object) -> str:
        arguments = {"group": request.group, "controller": request.controller}
        self._node.group(request.group)
        await self._node.request(Event.SET_CONTROLLER, arguments)
        return f"{request.controller} takes over {request.group}"

    async def _set_gripper(self, request: SetGripper.Request, response: SetGripper.Response) -> str:
        opening = 0.0 if request.close else self._node.cell.gripper.stroke
        messages.check_finite(force=request.force)
        arguments = {"gripper": request.gripper, "opening": opening, "force": request.force}
        results = await self._node.request(Event.SET_GRIPPER, arguments)
        response.opening = float(results["opening"])
        return ""
