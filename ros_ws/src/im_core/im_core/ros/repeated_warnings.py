"""Reminders of a node: a warning in the log once, and on ``/diagnostics`` from then on."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.publisher import Publisher

from im_core.ros import qos
from im_core.ros.guard import GuardedNode

#: How the subject begins that tells of a node which no message reaches; the name of that node follows.
LINK = "link to "
MOST = 20
PERIOD_S = 1.0


class Reminders:
    """Warnings of a node, the last of each subject on ``/diagnostics`` as ``NODE: SUBJECT``."""

    def __init__(self, node: GuardedNode) -> None:
        self._node = node
        self._said: dict[str, list[str]] = {}
        self._publisher: Publisher | None = None

    def add(self, subject: str, text: str) -> None:
        """Write a warning to the log, and keep the warning on ``/diagnostics``."""
        self._node.get_logger().warning(text)
        said = self._said.setdefault(subject, [])
        said.append(text)
        del said[:-MOST]
        if self._publisher is None:
            self._publisher = self._node.create_publisher(DiagnosticArray, "/diagnostics", qos.STATUS)
            self._node.create_timer(PERIOD_S, self._publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def end(self, subject: str) -> None:
        """Say nothing more of a subject: the last warning is not true any more."""
        if self._said.pop(subject, None):
            self._node.get_logger().info(f"{subject}: over")

    def _publish(self) -> None:
        assert self._publisher is not None, "the timer is made with it"
        name = self._node.get_name()
        message = DiagnosticArray()
        for subject, said in self._said.items():
            values = [KeyValue(key=str(number), value=text) for number, text in enumerate(said, 1)]
            status = DiagnosticStatus(level=DiagnosticStatus.WARN, name=f"{name}: {subject}", hardware_id=name)
            status.message, status.values = said[-1], values
            message.status.append(status)
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
