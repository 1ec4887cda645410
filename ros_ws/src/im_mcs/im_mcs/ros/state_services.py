"""Services of the state manager, of the grippers and of the control laws."""

from typing import TYPE_CHECKING

from std_srvs.srv import Trigger

from im_core.errors import ImError
from im_mcs.state import Event
from im_msgs.srv import ReserveGroup, SetController, SetGripper

if TYPE_CHECKING:
    from im_mcs.ros.node import McsNode

_TRIGGERS = (
    Event.POWER_ON,
    Event.POWER_OFF,
    Event.ENABLE_MOTION,
    Event.DISABLE_MOTION,
    Event.ESTOP,
    Event.RESET,
)


class StateServices:
    """``/mcs/reserve``, ``/mcs/release``, a ``std_srvs/Trigger`` an event, ``set_gripper`` and ``set_controller``.

    Args:
        node: The node that offers them.
    """

    def __init__(self, node: "McsNode") -> None:
        self._node = node
        for event in (Event.RESERVE, Event.RELEASE):
            node.create_service(ReserveGroup, f"/mcs/{event.value}", self._on_group(event))
        for event in _TRIGGERS:
            node.create_service(Trigger, f"/mcs/{event.value}", self._on_trigger(event))
        node.create_service(SetGripper, "/mcs/set_gripper", self._set_gripper)
        node.create_service(SetController, "/mcs/set_controller", self._set_controller)

    def _on_group(self, event: Event) -> object:
        async def serve(request: ReserveGroup.Request, response: ReserveGroup.Response) -> ReserveGroup.Response:
            try:
                await self._node.request(event, {"group": request.group})
                response.success, response.message = True, f"MCS is {self._node.state.value}"
            except ImError as error:
                response.success, response.message = False, error.message
            return response

        return serve

    def _on_trigger(self, event: Event) -> object:
        async def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                await self._node.transition(event)
                response.success, response.message = True, f"MCS is {self._node.state.value}"
            except ImError as error:
                response.success, response.message = False, error.message
            return response

        return serve

    async def _set_gripper(self, request: SetGripper.Request, response: SetGripper.Response) -> SetGripper.Response:
        opening = 0.0 if request.close else self._node.model.cell.gripper.stroke
        try:
            results = await self._node.request(Event.SET_GRIPPER, {"gripper": request.gripper, "opening": opening})
            response.success, response.opening = True, float(results["opening"])
        except ImError as error:
            response.success, response.message = False, error.message
        return response

    async def _set_controller(
        self, request: SetController.Request, response: SetController.Response
    ) -> SetController.Response:
        try:
            arguments = {"group": request.group, "controller": request.controller}
            await self._node.request(Event.SET_CONTROLLER, arguments)
            response.success, response.message = True, f"{request.controller} takes over {request.group}"
        except ImError as error:
            response.success, response.message = False, error.message
        return response
