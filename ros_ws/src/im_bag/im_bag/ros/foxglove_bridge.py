"""``foxglove_bridge``: shows the topics of the ROS domain in Foxglove; subscribes to what its viewers have opened."""

import sys
from typing import Any

import foxglove
from foxglove.websocket import ServerListener, WebSocketServer
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription

from im_bag.definitions import full_definition
from im_bag.ros.recorder import QUEUE_DEPTH
from im_core.errors import ImError, LinkError
from im_core.ros.messages.interfaces import interface_class
from im_core.ros.node import ManagedNode
from im_core.ros.qos import offered
from im_core.ros.run import main as run_main

PORT = 8765
#: How often the bridge looks for topics that have come or gone [s].
LOOK_S = 1.0


class FoxgloveChannel:
    """Topic as Foxglove sees it, and its subscription while a viewer has it open.

    Raises:
        ImError: No sourced workspace defines the type.
    """

    def __init__(self, topic: str, type_name: str) -> None:
        definition = full_definition(type_name)
        self.topic, self.kind = topic, interface_class(type_name)
        schema = foxglove.Schema(name=type_name, encoding=definition.encoding, data=definition.text.encode())
        self.channel = foxglove.Channel(topic, message_encoding="cdr", schema=schema)
        self.viewers: set[int] = set()
        self.subscription: Subscription | None = None


class FoxgloveBridge(ManagedNode):
    """Bridge of the protocol ``foxglove.sdk.v1``: offers every topic, and only shows.

    A topic without viewers has no subscription. A further viewer has it made anew: what is latched comes once more.
    """

    def __init__(self, *, parameter_overrides: list[Parameter] | None = None) -> None:
        super().__init__("foxglove_bridge", parameter_overrides=parameter_overrides)
        declare = self.declared.declare
        self._host = declare("host", "127.0.0.1", "address that Foxglove connects to; 0.0.0.0: all of this computer's")
        self._port = declare("port", PORT, "TCP port that Foxglove connects to", span=(1024, 65535))
        self._channels: dict[str, FoxgloveChannel] = {}
        self._refused: set[tuple[str, str]] = set()
        self._server: WebSocketServer | None = None

    def phase_configure(self) -> None:
        """Open the port, and offer the topics.

        Raises:
            LinkError: The port is in use.
        """
        try:
            self._server = foxglove.start_server(
                name=f"im, ROS domain {self.context.get_domain_id()}",
                host=self._host,
                port=self._port,
                server_listener=_Viewers(self),
                supported_encodings=["cdr"],
            )
        except RuntimeError as error:
            raise LinkError(f"Foxglove cannot be served on {self._host}:{self._port}: {error}") from error
        self.get_logger().info(f"Foxglove connects to ws://{self._host}:{self._port}")
        self._look()
        self.create_timer(LOOK_S, self._look, clock=self.steady_clock)

    def phase_shutdown(self) -> None:
        """Close the port."""
        if self._server is not None:
            self._server.stop()

    async def view(self, viewer: int, topic: str) -> None:
        """Subscribe to a topic for a viewer."""
        if (found := self._channels.get(topic)) is None:
            return
        found.viewers.add(viewer)
        self._unsubscribe(found)
        profile = offered(self.get_publishers_info_by_topic(topic), QUEUE_DEPTH)

        def show(data: bytes) -> None:
            found.channel.log(data, log_time=self.get_clock().now().nanoseconds)

        found.subscription = self.create_subscription(found.kind, topic, show, profile, raw=True)

    async def leave(self, viewer: int, topic: str) -> None:
        """End the subscription of a topic with its last viewer."""
        if (found := self._channels.get(topic)) is not None:
            found.viewers.discard(viewer)
            if not found.viewers:
                self._unsubscribe(found)

    def _unsubscribe(self, found: FoxgloveChannel) -> None:
        if found.subscription is not None:
            self.destroy_subscription(found.subscription)
            found.subscription = None

    def _look(self) -> None:
        """Offer the topics that have come, and withdraw those that have gone."""
        topics = {name: types[0] for name, types in self.get_topic_names_and_types() if "/_" not in name}
        published = {topic: kind for topic, kind in topics.items() if self.count_publishers(topic)}
        for topic in self._channels.keys() - published.keys():
            gone = self._channels.pop(topic)
            self._unsubscribe(gone)
            gone.channel.close()
        for topic, kind in published.items():
            if topic in self._channels or (topic, kind) in self._refused:
                continue
            try:
                self._channels[topic] = FoxgloveChannel(topic, kind)
            except ImError as error:
                self._refused.add((topic, kind))
                self.get_logger().warning(f"{topic} is not offered to Foxglove: {error.message}")


class _Viewers(ServerListener):
    """Listener for the viewers of a bridge, in the threads of the server."""

    def __init__(self, bridge: FoxgloveBridge) -> None:
        self._bridge = bridge

    def on_subscribe(self, client: Any, channel: Any) -> None:
        self._bridge.spawn(self._bridge.view(client.id, channel.topic))

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        self._bridge.spawn(self._bridge.leave(client.id, channel.topic))


def main() -> int:
    """Run the node ``/foxglove_bridge``."""
    return run_main(FoxgloveBridge)


if __name__ == "__main__":
    sys.exit(main())
