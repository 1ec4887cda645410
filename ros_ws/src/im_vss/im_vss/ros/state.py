"""Reports of a vision process on its node: loaded parts, queues and owners, and the health on ``/diagnostics``."""

from functools import partial

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.client import Client

from im_core.errors import ImError
from im_core.ros import qos
from im_core.ros.calls import call
from im_core.ros.messages.stamps import wall_stamp
from im_core.ros.messages.status import ok_status, to_status
from im_core.ros.node import ManagedNode
from im_msgs.msg import VisionModuleState
from im_msgs.msg import VisionState as VisionStateMessage
from im_msgs.srv import VisionCancel, VisionQuery
from im_vss.camera_book import CameraBook
from im_vss.catalogue import PROCESS
from im_vss.laser.book import LaserBook
from im_vss.vsm import VisionServicesManager, VisionState

STATE_PERIOD_S = 0.2
CANCEL_S = 10.0
"""How long another process may take to cancel a request."""
DIAGNOSTICS_PERIOD_S = 1.0

_HARDWARE = "cameras and laser scanner"


class StatePort:
    """Port of ``state`` (latched, on change), ``query`` and ``cancel`` of a vision process, below the node's name.

    In the process of the cameras, the one central point of access, they are of all processes.
    """

    def __init__(self, node: ManagedNode, vsm: VisionServicesManager) -> None:
        """Offer topic and services on `node`."""
        self._node, self._vsm = node, vsm
        self._last: object = None
        own = node.get_name()
        self._publisher = node.create_publisher(VisionStateMessage, f"/{own}/state", qos.LATCHED)
        self._told: dict[str, VisionStateMessage] = {}
        self._cancels: dict[str, Client] = {}
        for name in (name for name in vsm.in_use.processes if own == PROCESS != name):
            node.create_subscription(VisionStateMessage, f"/{name}/state", partial(self._keep, name), qos.LATCHED)
            self._cancels[name] = node.create_client(VisionCancel, f"/{name}/cancel")
        node.create_service(VisionQuery, f"/{own}/query", self._query)
        node.create_service(VisionCancel, f"/{own}/cancel", self._cancel, urgent=True)
        node.create_timer(STATE_PERIOD_S, self._publish, clock=node.steady_clock)

    def _keep(self, process: str, message: VisionStateMessage) -> None:
        self._told[process], self._last = message, None

    def _present(self) -> list[VisionStateMessage]:
        """Return the states of the other processes; the last word of a dead one does not count."""
        there = [name for name in self._told if self._node.count_publishers(f"/{name}/state")]
        return [self._told[name] for name in there]

    def _query(self, _: VisionQuery.Request, response: VisionQuery.Response) -> VisionQuery.Response:
        response.state = self._message()
        return response

    async def _cancel(self, request: VisionCancel.Request, response: VisionCancel.Response) -> VisionCancel.Response:
        asked = self._vsm.in_use.services.get(request.request.partition(" #")[0])
        try:
            if asked is not None and asked.process in self._cancels:
                cancel, what = self._cancels[asked.process], f"/{asked.process} to cancel"
                answer: VisionCancel.Response = await call(self._node, cancel, request, CANCEL_S, what)
                return answer
            self._vsm.cancel(request.request)
        except ImError as error:
            response.status = to_status(error)
            return response
        response.success, response.status = True, ok_status()
        return response

    def _publish(self) -> None:
        state, others = self._vsm.state(), len(self._present())
        seen = (state.requests, [(s.owner, s.queue, s.leases, s.released) for _, s in state.modules.values()], others)
        if seen != self._last:
            self._last = seen
            self._publisher.publish(self._message())

    def _message(self) -> VisionStateMessage:
        message = self._own()
        for other in self._present():
            for part in ("services", "tools", "requests", "modules"):
                setattr(message, part, [*getattr(message, part), *getattr(other, part)])
        return message

    def _own(self) -> VisionStateMessage:
        state = self._vsm.state()
        return VisionStateMessage(
            stamp=wall_stamp(),
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


class DiagnosticsPort:
    """Port of ``/diagnostics``, once a second of wall time: origins of the calibrations, and users of the Modules."""

    def __init__(
        self, node: ManagedNode, vsm: VisionServicesManager, book: CameraBook | None, laser: LaserBook | None
    ) -> None:
        """Publish the diagnostics from `node`; without `book`, of the Modules alone."""
        self._node = node
        self._vsm = vsm
        self._book = book
        self._laser = laser
        self._lapsed = _lapsed(vsm.state())
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos.STATUS)
        node.create_timer(DIAGNOSTICS_PERIOD_S, self._publish, clock=node.steady_clock)

    def _publish(self) -> None:
        message = DiagnosticArray(status=[self._modules()])
        if self._book is not None:
            message.status.insert(0, self._calibrations(self._book))
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def _calibrations(self, book: CameraBook) -> DiagnosticStatus:
        """Return the status of the calibrations; a camera as drawn, as at the machine's start, is no fault."""
        entries = book.entries()
        cameras = f"{sum(entry.calibrated for entry in entries)} of {len(entries)} cameras are calibrated"
        origins = {entry.name: entry.origin for entry in entries}
        if self._laser is None:
            return _status("vss: calibrations", cameras, origins)
        laser = self._laser.entry
        scanner = "calibrated" if laser.calibrated else "as drawn"
        told = f"{cameras}; the laser scanner is {scanner}"
        return _status("vss: calibrations", told, origins | {"laser_scanner": laser.origin})

    def _modules(self) -> DiagnosticStatus:
        state = self._vsm.state()
        before, self._lapsed = self._lapsed, _lapsed(state)
        lapsed = [name for name, count in self._lapsed.items() if count > before[name]]
        values: dict[str, object] = {}
        for name, (_, module) in state.modules.items():
            parts = {"owner": module.owner or "free", "queue": len(module.queue), "leases": module.leases}
            values |= {f"{name} {part}": value for part, value in {**parts, "lapsed": module.lapsed}.items()}
        under_way = f"requests under way: {len(state.requests)}"
        status = _status(f"{self._node.get_name()}: modules", under_way, values)
        if lapsed:
            status.level = DiagnosticStatus.WARN
            status.message = f"{under_way}; a lease lapsed of {', '.join(lapsed)}"
        return status


def _lapsed(state: VisionState) -> dict[str, int]:
    return {name: module.lapsed for name, (_, module) in state.modules.items()}


def _status(name: str, message: str, values: dict[str, object] | dict[str, str]) -> DiagnosticStatus:
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticStatus(level=DiagnosticStatus.OK, name=name, message=message, hardware_id=_HARDWARE, values=pairs)
