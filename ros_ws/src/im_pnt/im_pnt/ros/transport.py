"""Tokens, requests and replies between processes: topics ``/<node>/tokens`` and ``/<node>/token_acks``."""

import json
from collections.abc import Callable

from rclpy.publisher import Publisher

from im_core.clock import monotonic, wall
from im_core.ros import qos
from im_core.ros.node import ManagedNode
from im_core.ros.status import ok_status, status_to_error, to_status
from im_msgs.msg import NetDescription, Token, TokenAck
from im_pnt.remote import Ack, Envelope, Kind, Message, Receiver, Sender

RESEND_PERIOD_S = 0.1


class DdsTransport:
    """Delivers messages once, over DDS topics.

    Args:
        node: The node.
        accept: Takes a new message from a sender; returns why it is refused, empty if it is not.
        refused: Takes back a message that its receiver refused, with the reason.
    """

    def __init__(
        self,
        node: ManagedNode,
        accept: Callable[[str, Message], str],
        refused: Callable[[Message, str], None],
    ) -> None:
        name = node.task_name
        self.epoch = int(wall() * 1e6)
        self._node = node
        self._refused = refused
        self._sender = Sender(name, self.epoch)
        self._receiver = Receiver(name, self.epoch, accept)
        self._directory: dict[str, str] = {}
        self._token_publishers: dict[str, Publisher] = {}
        self._ack_publishers: dict[str, Publisher] = {}
        node.create_subscription(Token, f"/{name}/tokens", self._hear, qos.EVENTS)
        node.create_subscription(TokenAck, f"/{name}/token_acks", self._hear_ack, qos.EVENTS)
        node.create_subscription(NetDescription, "/pnt/nets", self._learn, qos.LATCHED_MANY)
        node.create_timer(RESEND_PERIOD_S, self._resend, clock=node.steady_clock)

    def node_of(self, net: str) -> str:
        """Returns the node that has announced a net, or the one of its name."""
        return self._directory.get(net, net)

    def prepare(self, net: str) -> None:
        """Makes the publishers to a net's node before they are needed: discovery takes time."""
        node = self.node_of(net)
        self._publisher(self._token_publishers, node, Token, "tokens")
        self._publisher(self._ack_publishers, node, TokenAck, "token_acks")

    def send(self, node: str, message: Message) -> None:
        """Sends a message, and again until it is acknowledged."""
        self._transmit(self._sender.send(node, message, monotonic()))

    def forget(self, request_id: str) -> None:
        """Stops repeating what was sent about a request."""
        self._sender.forget(request_id)

    def _resend(self) -> None:
        if self._sender.unacknowledged():
            for envelope in self._sender.due(monotonic()):
                self._transmit(envelope)

    def _transmit(self, envelope: Envelope) -> None:
        publisher = self._publisher(self._token_publishers, envelope.receiver, Token, "tokens")
        publisher.publish(_to_token(envelope))

    def _hear(self, token: Token) -> None:
        try:
            envelope = _to_envelope(token, self._node.task_name)
        except ValueError as error:
            self._node.get_logger().warning(f"a token of {token.sender} cannot be read: {error}")
            return
        ack = self._receiver.receive(envelope)
        message = TokenAck(
            receiver=ack.receiver,
            epoch=ack.epoch,
            sequence=ack.sequence,
            receiver_epoch=ack.receiver_epoch,
            accepted=not ack.refusal,
            message=ack.refusal,
        )
        self._publisher(self._ack_publishers, envelope.sender, TokenAck, "token_acks").publish(message)

    def _hear_ack(self, message: TokenAck) -> None:
        refusal = "" if message.accepted else message.message or "refused"
        ack = Ack(
            message.receiver,
            self._node.task_name,
            int(message.epoch),
            int(message.sequence),
            int(message.receiver_epoch),
            refusal,
        )
        returned = self._sender.acknowledged(ack)
        if returned is not None:
            self._refused(returned, refusal)

    def _learn(self, description: NetDescription) -> None:
        self._directory[description.net] = description.node.rpartition("/")[2]

    def _publisher(self, known: dict[str, Publisher], node: str, message_type: type, topic: str) -> Publisher:
        if node not in known:
            known[node] = self._node.create_publisher(message_type, f"/{node}/{topic}", qos.EVENTS)
        return known[node]


def _to_token(envelope: Envelope) -> Token:
    message = envelope.message
    return Token(
        sender=envelope.sender,
        epoch=envelope.epoch,
        sequence=envelope.sequence,
        kind=int(message.kind),
        net=message.net,
        place=message.place,
        request_id=message.request_id,
        caller_net=message.caller_net,
        caller_transition=message.caller_transition,
        command_id=message.command_id,
        success=message.error is None,
        status=ok_status() if message.error is None else to_status(message.error),
        payload=json.dumps(message.payload, default=str),
    )


def _to_envelope(token: Token, receiver: str) -> Envelope:
    payload = json.loads(token.payload or "{}")
    if not isinstance(payload, dict):
        raise ValueError("its payload is not a JSON object")
    message = Message(
        Kind(token.kind),
        token.net,
        token.place,
        token.request_id,
        token.caller_net,
        token.caller_transition,
        int(token.command_id),
        None if token.success else status_to_error(token.status),
        payload,
    )
    return Envelope(token.sender, receiver, int(token.epoch), int(token.sequence), message)
