"""Packets of a link between processes: topics ``/<node>/tokens``."""

from collections.abc import Callable

from rclpy.exceptions import NameValidationException
from rclpy.publisher import Publisher
from rclpy.validate_node_name import validate_node_name

from im_core.errors import DataError, StateError
from im_core.ros import qos
from im_core.ros.heartbeats import Heartbeats
from im_core.ros.node import ManagedNode
from im_core.ros.qos import MOST_NETS
from im_msgs.msg import NetDescription, TokenPacket
from im_pnt.description import read_content
from im_pnt.errors import NetError
from im_pnt.execution.notification import Observer
from im_pnt_node.distributed.exchange import Exchange
from im_pnt_node.distributed.link import Link
from im_pnt_node.distributed.packets import Message
from im_pnt_node.ros.cdr import decode_packet, encode_packet
from im_pnt_node.ros.execution.loop import NetLoop

TICK_PERIOD_S = 0.05


class DdsTransport:
    """Link over DDS topics, with the nodes of all nets.

    Args:
        node: The node.
        epoch: Its incarnation.
        heartbeats: Tells of the death of nodes.
        observer: Is told of packets that make no sense, of forgeries, and of journals that are too old.
    """

    def __init__(self, node: ManagedNode, epoch: int, heartbeats: Heartbeats, observer: Observer) -> None:
        self._node, self._heartbeats = node, heartbeats
        self._watched: dict[str, Callable[[], None]] = {}
        self._directory: dict[str, str] = {}
        self._journalling: set[str] = set()
        self._publishers: dict[str, Publisher] = {}
        self._wake: Callable[[], None] = lambda: None
        self.link = Link(
            node.task_name,
            epoch,
            lambda sender, message: f"{node.task_name} does not listen yet",
            lambda message, why: self._exchange.refused(message, why),
            lambda peer, why, in_flight: self._exchange.node_reset(peer, why, in_flight),
            self._heard,
            self._transmit,
            observer,
        )
        self._tick_timer = node.create_timer(TICK_PERIOD_S, self._tick, clock=node.steady_clock)
        self._tick_timer.cancel()
        self._ticking = False
        node.create_subscription(NetDescription, "/pnt/nets", self._learn, qos.LATCHED_NETS)

    def listen(self, exchange: Exchange, loop: NetLoop) -> None:
        """Begin to take packets.

        Args:
            exchange: For which; its nets are there now.
            loop: Has the nets go on with what has arrived.
        """
        self._exchange, self._loop, self._wake = exchange, loop, loop.wake
        self.link.accept = exchange.receive
        topic = f"/{self._node.task_name}/tokens"
        self._node.create_subscription(TokenPacket, topic, self._hear, qos.EVENTS, raw=True)
        self._ticking = True
        self._tick_timer.reset()

    def node_of(self, net: str) -> str:
        """Return the node announcing a net, or else the node of the same name."""
        return self._directory.get(net, net)

    def prepare(self, net: str) -> None:
        """Create the publisher to a net's node before the first use: discovery takes time."""
        self._publisher(self.node_of(net))

    def send(self, node: str, message: Message) -> None:
        """Send a message, to arrive once, some time, and in order.

        Raises:
            NetError: JSON cannot carry a part of it.
        """
        if node not in self._watched:
            self._watch(node)
        self.link.send(node, message)
        self._wake()  # where a coroutine sends it, no turn need come by itself that lets it leave

    def forget(self, request_id: str) -> None:
        """Send nothing more about a request."""
        self.link.forget(request_id)

    def keeps_journal(self, node: str) -> bool:
        """Return whether a node has announced a journal, in a packet or with the description of a net."""
        return self.link.keeps_journal(node) or node in self._journalling

    def flush(self) -> None:
        """Send new messages; call after the write of the journal."""
        self.link.flush()
        if not self._ticking and not self.link.idle():
            self._ticking = True
            self._tick_timer.reset()

    def _heard(self, node: str) -> None:
        self._exchange.node_returned(node)
        if node not in self._watched:
            self._watch(node)

    def _watch(self, node: str) -> None:
        """Inform the exchange of the death of a partner node."""
        since = self._heartbeats.incarnation(node)
        self._watched[node] = self._heartbeats.watch(node, since, lambda why: self._lost(node, why))

    def _lost(self, node: str, why: str) -> None:
        self._watched.pop(node)()
        self._exchange.node_lost(node, why)
        self._loop.turn()

    def _hear(self, data: bytes) -> None:
        try:
            text = decode_packet(data)
        except NetError as error:
            self._node.get_logger().warning(f"a packet was dropped: {error.message}")
        else:
            self._loop.take_packet(self.link.hear, text)

    def _tick(self) -> None:
        self.link.tick()
        if self.link.idle():
            self._ticking = False
            self._tick_timer.cancel()

    def _transmit(self, node: str, text: str) -> None:
        publisher = self._publishers.get(node)
        if publisher is None:
            if node not in self.link.peers and not self._node.count_subscribers(f"/{node}/tokens"):
                return  # a stranger whom nobody would hear: no publisher is made for a name that somebody made up
            publisher = self._publisher(node)
        publisher.publish(encode_packet(text))

    def _learn(self, description: NetDescription) -> None:
        """Note the node of a net; refuse a name without a possible publisher.

        Raises:
            DataError: There can be no node of that name.
            StateError: It is known of too many others.
        """
        node = description.node.rpartition("/")[2]
        if not description.json:  # it has gone from there; another node may have taken it over
            if self._directory.get(description.net) == node:
                del self._directory[description.net]
            return
        try:
            content = read_content(description.net, description.json)
        except DataError:  # who reads the nets of others says so
            return
        try:
            validate_node_name(node)
        except NameValidationException as error:
            text = f"net {description.net} is described by a node of no possible name: {node[:100]!r}"
            raise DataError(text, net=description.net) from error
        if len(self._directory) == MOST_NETS and description.net not in self._directory:
            text = f"who runs net {description.net} is not learned: it is known of {MOST_NETS} others"
            raise StateError(text, net=description.net)
        self._directory[description.net] = node
        if content.journal and len(self._journalling) < MOST_NETS:
            self._journalling.add(node)

    def _publisher(self, node: str) -> Publisher:
        if node not in self._publishers:
            self._publishers[node] = self._node.create_publisher(TokenPacket, f"/{node}/tokens", qos.EVENTS)
        return self._publishers[node]
