"""Last message of a topic repeated by a living node."""

from collections.abc import Callable
from typing import Generic, TypeVar

from rclpy.node import Node
from rclpy.qos import QoSProfile

from im_core import clock

MessageT = TypeVar("MessageT")


class Latest(Generic[MessageT]):
    """Keep the last message of a topic, and detect a silent node: a latched message outlives no node.

    Args:
        node: The node that listens.
        message_type: Type of the topic.
        topic: Its name.
        profile: Quality of service.
        silence_s: Wall time without a message after which the last one is stale [s].
        heard: Called after every message.

    Attributes:
        message: The last message, None before the first.
        silence_s: As given.
    """

    def __init__(
        self,
        node: Node,
        message_type: type[MessageT],
        topic: str,
        profile: QoSProfile,
        silence_s: float,
        heard: Callable[[], None] = lambda: None,
    ) -> None:
        self.message: MessageT | None = None
        self.silence_s, self._heard_at, self._heard = silence_s, 0.0, heard
        node.create_subscription(message_type, topic, self._take, profile)

    @property
    def stale(self) -> bool:
        """Whether no message came, or the silence is too long to trust the last message."""
        return self.message is None or clock.monotonic() - self._heard_at > self.silence_s

    def forget(self) -> None:
        """As before the first message; the next one will be new."""
        self.message = None

    def _take(self, message: MessageT) -> None:
        self.message, self._heard_at = message, clock.monotonic()
        self._heard()
