"""What the Vision Services Manager has loaded, queued and owned, for everybody to see."""

from im_core import clock
from im_core.errors import ImError
from im_core.ros import qos
from im_core.ros.node import ManagedNode
from im_core.ros.status import ok_status, to_status
from im_msgs.msg import VisionModuleState, VisionState
from im_msgs.srv import VisionCancel, VisionQuery
from im_vss.ros.messages import to_time
from im_vss.vsm import VisionServicesManager

PERIOD_S = 0.2


class StatePort:
    """``/vss/state`` (latched, when it changed), ``/vss/query`` and ``/vss/cancel``."""

    def __init__(self, node: ManagedNode, vsm: VisionServicesManager) -> None:
        """Offer them on `node`."""
        self._vsm = vsm
        self._last: object = None
        self._publisher = node.create_publisher(VisionState, "/vss/state", qos.LATCHED)
        node.create_service(VisionQuery, "/vss/query", self._query)
        node.create_service(VisionCancel, "/vss/cancel", self._cancel)
        node.create_timer(PERIOD_S, self._publish, clock=node.steady_clock)

    def _query(self, _: VisionQuery.Request, response: VisionQuery.Response) -> VisionQuery.Response:
        response.state = self._message()
        return response

    def _cancel(self, request: VisionCancel.Request, response: VisionCancel.Response) -> VisionCancel.Response:
        try:
            self._vsm.cancel(request.request)
        except ImError as error:
            response.status = to_status(error)
            return response
        response.success, response.status = True, ok_status()
        return response

    def _publish(self) -> None:
        state = self._vsm.state()
        seen = (state.requests, [(s.owner, s.queue, s.leases, s.released) for _, s in state.modules.values()])
        if seen != self._last:
            self._last = seen
            self._publisher.publish(self._message())

    def _message(self) -> VisionState:
        state = self._vsm.state()
        return VisionState(
            stamp=to_time(int(clock.wall() * 1e9)),
            services=list(state.services),
            tools=list(state.tools),
            requests=list(state.requests),
            modules=[
                VisionModuleState(
                    name=name,
                    manager=manager,
                    owner=module.owner,
                    remaining=module.remaining_s,
                    queue=list(module.queue),
                    leases=module.leases,
                    released=module.released,
                    lapsed=module.lapsed,
                )
                for name, (manager, module) in state.modules.items()
            ],
        )
