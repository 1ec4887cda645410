"""``pnt_display``: shows every net of the machine on a web page."""

import json
import sys
from collections.abc import Mapping
from typing import Any

from im_core.errors import ImError, NotFoundError
from im_core.names import run_dir
from im_core.ros import qos
from im_core.ros.calls import call
from im_core.ros.node import ManagedNode
from im_core.ros.run import main as run_main
from im_msgs.msg import Firing, Marking, NetDescription, NetRefusal
from im_msgs.srv import ControlNet
from im_pnt.display.server import DisplayServer
from im_pnt.events import Phase

ANSWER_S = 5.0


class DisplayNode(ManagedNode):
    """ROS shell of :class:`im_pnt.display.server.DisplayServer`; translates messages, decides nothing.

    Parameters: ``host`` (127.0.0.1) and ``port`` (8080; the next free one if in use).
    """

    def __init__(self, **kwargs: object) -> None:
        super().__init__("pnt_display", **kwargs)
        host = str(self.declare_parameter("host", "127.0.0.1").value)
        port = int(self.declare_parameter("port", 8080).value)
        self.server = DisplayServer(host, port, self._wanted)
        self._nodes: dict[str, str] = {}
        self._operators: dict[str, Any] = {}

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
        self.create_subscription(NetRefusal, "/pnt/refusals", self._refuse, qos.LATCHED_MANY)
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
        self._nodes[message.net] = message.node
        self.server.show(self.server.state.net(message.net, message.node, content))

    def _refuse(self, message: NetRefusal) -> None:
        try:
            content = json.loads(message.json)
        except json.JSONDecodeError as error:
            self.get_logger().warning(f"the refusal of net {message.net} cannot be read: {error}")
            return
        refusal = {"message": message.message, "counterexample": content}
        self.server.show(self.server.state.refusal(message.net, refusal))

    def _mark(self, message: Marking) -> None:
        marking = {
            "tokens": {place: int(count) for place, count in zip(message.places, message.tokens, strict=False)},
            "active": list(message.active),
            "cancelling": list(message.cancelling),
            "in_doubt": list(message.in_doubt),
            "sequence": int(message.sequence),
            "mode": message.mode,
            "paused": message.paused,
            "proposed": list(message.proposed),
        }
        self.server.show(self.server.state.marking(message.net, marking))

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

    # What viewers ask for; it comes in the server's thread.

    def _wanted(self, wanted: Mapping[str, Any]) -> None:
        self.executor.create_task(self._operate(wanted["net"], wanted["request"], wanted["argument"]))
        self.wake()

    async def _operate(self, net: str, request: str, argument: str) -> None:
        try:
            asked = ControlNet.Request(net=net, request=request, argument=argument)
            answer = await call(self, self._operator(net), asked, ANSWER_S, f"{request} of net {net}")
        except ImError as error:
            self.server.show(self.server.state.answer(net, False, error.message))
        else:
            self.server.show(self.server.state.answer(net, answer.success, answer.message))

    def _operator(self, net: str) -> Any:
        """The client that operates a net.

        Raises:
            NotFoundError: There is no such net.
        """
        if net not in self._nodes:
            raise NotFoundError(kind="net", name=net, known=self._nodes)
        node = self._nodes[net]
        if node not in self._operators:
            self._operators[node] = self.create_client(ControlNet, f"{node}/control_net")
        return self._operators[node]


def main() -> int:
    """Runs the node ``/pnt_display``."""
    return run_main(DisplayNode)


if __name__ == "__main__":
    sys.exit(main())
