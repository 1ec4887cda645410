"""``pnt_display``: shows every net of the machine on a web page."""

import json
import sys

from im_core.names import run_dir
from im_core.ros import qos
from im_core.ros.node import ManagedNode
from im_core.ros.run import main as run_main
from im_msgs.msg import Firing, Marking, NetDescription
from im_pnt.display.server import DisplayServer
from im_pnt.events import Phase


class DisplayNode(ManagedNode):
    """ROS shell of :class:`im_pnt.display.server.DisplayServer`; translates messages, decides nothing.

    Parameters: ``host`` (127.0.0.1) and ``port`` (8080; the next free one if in use).
    """

    def __init__(self, **kwargs: object) -> None:
        super().__init__("pnt_display", **kwargs)
        host = str(self.declare_parameter("host", "127.0.0.1").value)
        port = int(self.declare_parameter("port", 8080).value)
        self.server = DisplayServer(host, port)

    def phase_configure(self) -> None:
        """Opens the page and follows the nets.

        Raises:
            LinkError: No port is free.
        """
        self.server.start()
        (run_dir() / "pnt_display.url").write_text(self.server.url + "\n", encoding="utf-8")
        self.create_subscription(NetDescription, "/pnt/nets", self._describe, qos.LATCHED_MANY)
        self.create_subscription(Marking, "/pnt/markings", self._mark, qos.LATCHED_MANY)
        self.create_subscription(Firing, "/pnt/firings", self._fire, qos.EVENTS)
        self.get_logger().info(f"nets are shown at {self.server.url}")

    def phase_shutdown(self) -> None:
        """Closes the page."""
        self.server.stop()
        (run_dir() / "pnt_display.url").unlink(missing_ok=True)

    def _describe(self, message: NetDescription) -> None:
        try:
            content = json.loads(message.json)
        except json.JSONDecodeError as error:
            self.get_logger().warning(f"the description of net {message.net} cannot be read: {error}")
            return
        self.server.show(self.server.state.net(message.net, message.node, content))

    def _mark(self, message: Marking) -> None:
        tokens = {place: int(count) for place, count in zip(message.places, message.tokens, strict=False)}
        change = self.server.state.marking(message.net, tokens, list(message.active), int(message.sequence))
        self.server.show(change)

    def _fire(self, message: Firing) -> None:
        firing = {
            "time": message.stamp.sec + message.stamp.nanosec * 1e-9,
            "net": message.net,
            "transition": message.transition,
            "sequence": int(message.sequence),
            "phase": Phase(message.phase).name if message.phase in list(Phase) else str(message.phase),
            "symbol": message.symbol,
            "command": int(message.command_id),
            "message": message.message,
            "duration": message.duration,
            "progress": message.progress,
        }
        self.server.show(self.server.state.firing(firing))


def main() -> int:
    """Runs the node ``/pnt_display``."""
    return run_main(DisplayNode)


if __name__ == "__main__":
    sys.exit(main())
