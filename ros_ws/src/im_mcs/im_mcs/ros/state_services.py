"""Services of the state manager."""

from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

from std_srvs.srv import Trigger

from im_mcs.ros import messages
from im_mcs.ros.serving import serving
from im_mcs.state import Event
from im_msgs.srv import RenewLease, ReserveGroup, SetPartition

if TYPE_CHECKING:
    from im_mcs.ros.node import McsNode

_TRIGGERS = (
    Event.POWER_ON,
    Event.POWER_OFF,
    Event.ENABLE_MOTION,
    Event.DISABLE_MOTION,
    Event.PROTECTIVE_STOP,
    Event.ESTOP,
    Event.RESET,
)


class StateServices:
    """``/mcs/reserve``, ``release``, ``renew``, ``set_partition``, and a ``std_srvs/Trigger`` an event.

    Args:
        node: The node that offers them.
    """

    def __init__(self, node: "McsNode") -> None:
        self._node = node
        node.create_service(ReserveGroup, "/mcs/reserve", serving(self._reserve))
        node.create_service(ReserveGroup, "/mcs/release", serving(self._release))
        node.create_service(RenewLease, "/mcs/renew", serving(self._renew))
        node.create_service(SetPartition, "/mcs/set_partition", serving(self._set_partition))
        for event in _TRIGGERS:
            node.create_service(Trigger, f"/mcs/{event.value}", serving(self._on_trigger(event)))

    async def _reserve(self, request: ReserveGroup.Request, _: object) -> str:
        self._node.group(request.group)
        messages.check_finite(lease=request.lease)
        arguments = {"group": request.group, "owner": request.owner, "lease_s": request.lease}
        await self._node.request(Event.RESERVE, arguments)
        return f"MCS is {self._node.state.value}"

    async def _release(self, request: ReserveGroup.Request, _: object) -> str:
        self._node.group(request.group)
        await self._node.request(Event.RELEASE, {"group": request.group})
        return f"MCS is {self._node.state.value}"

    async def _renew(self, request: RenewLease.Request, _: object) -> str:
        await self._node.request(Event.RENEW, {"owner": request.owner})
        return f"the lease of '{request.owner}' is renewed"

    async def _set_partition(self, request: SetPartition.Request, _: object) -> str:
        await self._node.repartition(request.preset)
        return f"the groups are {', '.join(self._node.config.groups)}"

    def _on_trigger(self, event: Event) -> Callable[[Any, Any], Awaitable[str]]:
        async def work(*_: object) -> str:
            await self._node.transition(event)
            return f"MCS is {self._node.state.value}"

        return work
