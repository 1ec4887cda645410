"""What ``/vss`` says of itself on ``/diagnostics``."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from im_core.ros import qos
from im_core.ros.node import ManagedNode
from im_vss.camera_book import CameraBook
from im_vss.laser.book import LaserBook
from im_vss.vsm import VisionServicesManager, VisionState

PERIOD_S = 1.0

_HARDWARE = "cameras and laser scanner"


class DiagnosticsPort:
    """``/diagnostics``, once a second of wall time: where the calibrations come from, and who uses the Modules."""

    def __init__(self, node: ManagedNode, vsm: VisionServicesManager, book: CameraBook, laser: LaserBook) -> None:
        """Publish them from `node`."""
        self._node = node
        self._vsm = vsm
        self._book = book
        self._laser = laser
        self._lapsed = _lapsed(vsm.state())
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos.STATUS)
        node.create_timer(PERIOD_S, self._publish, clock=node.steady_clock)

    def _publish(self) -> None:
        message = DiagnosticArray(status=[self._calibrations(), self._modules()])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def _calibrations(self) -> DiagnosticStatus:
        """A camera as drawn is no fault: the machine starts that way."""
        entries, laser = self._book.entries(), self._laser.entry
        cameras = f"{sum(entry.calibrated for entry in entries)} of {len(entries)} cameras are calibrated"
        origins = {entry.name: entry.origin for entry in entries} | {"laser_scanner": laser.origin}
        scanner = "calibrated" if laser.calibrated else "as drawn"
        return _status("vss: calibrations", f"{cameras}; the laser scanner is {scanner}", origins)

    def _modules(self) -> DiagnosticStatus:
        state = self._vsm.state()
        before, self._lapsed = self._lapsed, _lapsed(state)
        lapsed = [name for name, count in self._lapsed.items() if count > before[name]]
        values: dict[str, object] = {}
        for name, (_, module) in state.modules.items():
            parts = {"owner": module.owner or "free", "queue": len(module.queue), "leases": module.leases}
            values |= {f"{name} {part}": value for part, value in {**parts, "lapsed": module.lapsed}.items()}
        under_way = f"requests under way: {len(state.requests)}"
        status = _status("vss: modules", under_way, values)
        if lapsed:
            status.level = DiagnosticStatus.WARN
            status.message = f"{under_way}; a lease lapsed of {', '.join(lapsed)}"
        return status


def _lapsed(state: VisionState) -> dict[str, int]:
    return {name: module.lapsed for name, (_, module) in state.modules.items()}


def _status(name: str, message: str, values: dict[str, object] | dict[str, str]) -> DiagnosticStatus:
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticStatus(level=DiagnosticStatus.OK, name=name, message=message, hardware_id=_HARDWARE, values=pairs)
