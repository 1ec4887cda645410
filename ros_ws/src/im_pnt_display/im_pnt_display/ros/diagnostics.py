"""Topics of diagnostics and the log, subscribed to while somebody views the page."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log
from rclpy.subscription import Subscription

from im_core.ros import qos
from im_core.ros.node import ManagedNode

LOOK_S = 0.5
"""How often new lines of the log are shown [s]."""
MOST_DIAGNOSTICS = 200
MOST_LINES = 50
"""Lines of the log that are shown of each :data:`LOOK_S`; of others their number."""
LONGEST_LINE = 500
_LEVELS = {10: "debug", 20: "info", 30: "warning", 40: "error", 50: "fatal"}


class DiagnosticsTopics:
    """Subscriptions of a node to the diagnostics and the log.

    Args:
        node: The node.
        show_diagnostics: Shows all statuses: ``name``, ``level`` and ``message`` of each.
        show_log: Shows new lines: time [s since 1970], level, node and text of each.
    """

    def __init__(
        self,
        node: ManagedNode,
        show_diagnostics: Callable[[list[dict[str, object]]], None],
        show_log: Callable[[list[list[object]]], None],
    ) -> None:
        self._node, self._show_diagnostics, self._show_log = node, show_diagnostics, show_log
        self._subscriptions: list[Subscription] = []
        self._diagnostics: dict[str, dict[str, object]] = {}
        self._lines: list[list[object]] = []
        self._left_out = 0
        self._timer = node.create_timer(LOOK_S, self._show_lines, clock=node.steady_clock)
        self._timer.cancel()

    def follow(self, viewed: bool) -> None:
        """Begin to listen, or end; in the loop of the node."""
        if not viewed:
            self._timer.cancel()
            for subscription in self._subscriptions:
                self._node.destroy_subscription(subscription)
            self._subscriptions = []
        elif not self._subscriptions:
            self._timer.reset()
            listen = self._node.create_subscription
            self._subscriptions = [
                listen(DiagnosticArray, "/diagnostics", self._diagnose, qos.STATUS),
                listen(Log, "/rosout", self._log, qos.EVENTS),
            ]

    def _diagnose(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name not in self._diagnostics and len(self._diagnostics) >= MOST_DIAGNOSTICS:
                continue  # names that somebody makes up
            self._diagnostics[status.name] = {
                "name": status.name,
                "level": int.from_bytes(status.level, "little"),
                "message": status.message,
            }
        self._show_diagnostics(sorted(self._diagnostics.values(), key=lambda each: str(each["name"])))

    def _log(self, message: Log) -> None:
        if len(self._lines) >= MOST_LINES:
            self._left_out += 1
            return
        level = _LEVELS.get(int(message.level), str(message.level))
        at_s = message.stamp.sec + message.stamp.nanosec * 1e-9
        self._lines.append([round(at_s, 3), level, message.name[:100], message.msg[:LONGEST_LINE]])

    def _show_lines(self) -> None:
        if not self._lines:
            return
        lines, self._lines = self._lines, []
        if self._left_out:
            lines.append([lines[-1][0], "warning", "pnt_display", f"{self._left_out} lines more are in the log files"])
            self._left_out = 0
        self._show_log(lines)
