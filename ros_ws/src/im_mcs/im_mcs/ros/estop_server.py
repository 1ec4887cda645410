"""``/mcs/estop``, in a separate loop: answers independently of the node's loop."""

from typing import Any

from std_srvs.srv import Trigger

from im_core.ros import qos
from im_core.ros.guard import GuardedNode
from im_core.ros.run import spin_in_thread
from im_mcs.ros.access import McsAccess
from im_mcs.state import Event


class EstopServer:
    """Service ``/mcs/estop`` of a second node, ``mcs_estop``, in a separate thread."""

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        name = f"/mcs/{Event.ESTOP.value}"
        node = GuardedNode("mcs_estop", use_global_arguments=False, start_parameter_services=False)
        service = node.create_service(Trigger, name, self._serve)
        service.configure_introspection(access.node.get_clock(), qos.SERVICE_EVENTS, access.node.introspection)
        self._reason = f"request on {name}"
        self._spinner = spin_in_thread(node)

    def close(self) -> None:
        """End the service."""
        self._spinner.stop()

    def _serve(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, self._mcs.keeper.estop(self._reason)
        return response
