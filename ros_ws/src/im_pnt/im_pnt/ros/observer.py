"""Passes what nets tell on to whom it concerns: the topics, the clients of commands, the log."""

from collections.abc import Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.publisher import Publisher

from im_core.ros import qos
from im_core.ros.node import ManagedNode
from im_pnt.execution.jobs import Job
from im_pnt.execution.notification import Firing, Observer
from im_pnt.execution.operator import Mode
from im_pnt.ros.commands import Commands
from im_pnt.ros.publish import PntPublisher

MOST_FORGOTTEN = 20
DIAGNOSTICS_PERIOD_S = 1.0


class NodeObserver(Observer):
    """The observer of the nets of a node.

    Args:
        node: The node.
        publisher: Publishes what they do.

    Attributes:
        commands: Tells clients; None: there are none yet.
    """

    def __init__(self, node: ManagedNode, publisher: PntPublisher) -> None:
        self._node, self._publisher = node, publisher
        self.commands: Commands | None = None
        self._forgotten: list[str] = []
        self._diagnostics: Publisher | None = None

    def fired(self, firings: Sequence[Firing]) -> None:
        """Notes firings, and tells the clients of their commands."""
        self._publisher.fired(firings)
        if self.commands is not None:
            self.commands.fired(firings)

    def progressed(self, net: str, job: Job | None, text: str, fraction: float) -> None:
        """Tells the clients of a command."""
        if job is not None and self.commands is not None:
            self.commands.progressed(job.command.id, text, fraction)

    def troubled(self, net: str, text: str) -> None:
        """Writes a line of the log."""
        self._node.get_logger().warning(f"net {net}: {text}" if net else text)

    def forgot(self, text: str) -> None:
        """Writes a line of the log, and goes on saying it on ``/diagnostics``."""
        self.troubled("", text)
        self._forgotten.append(text)
        if self._diagnostics is None:
            self._diagnostics = self._node.create_publisher(DiagnosticArray, "/diagnostics", qos.STATUS)
            self._node.create_timer(DIAGNOSTICS_PERIOD_S, self._diagnose, clock=self._node.steady_clock)
        del self._forgotten[:-MOST_FORGOTTEN]

    def _diagnose(self) -> None:
        assert self._diagnostics is not None, "the timer is made with it"
        name = self._node.get_name()
        values = [KeyValue(key=str(number), value=text) for number, text in enumerate(self._forgotten, 1)]
        status = DiagnosticStatus(level=DiagnosticStatus.WARN, name=f"{name}: journal", hardware_id=name)
        status.message, status.values = self._forgotten[-1], values
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def chose(
        self, net: str, places: tuple[str, ...], probabilities: Mapping[str, float], entropy: float, taken: str
    ) -> None:
        """Publishes a choice among strategies."""
        self._publisher.chose(net, probabilities, entropy, taken)

    def operated(self, net: str, mode: Mode, paused: bool, proposed: tuple[str, ...]) -> None:
        """Has the marking shown anew."""
        self._publisher.changed(net)
