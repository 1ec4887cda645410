"""Share one reader between all nodes of a process following the same topic.

- Upstream: each subscription of a process takes and decodes each message of its topic itself; rclpy delivers nothing
  within a process. A process of seven nodes decoded each stamp of ``/clock`` seven times.
- Issue: none is known.
- Seen: rclpy 7.1.6 (Jazzy).
- Test: ``test_rclpy_still_decodes_a_message_once_for_each_subscription`` in
  ``test/test_rclpy_fixes.py`` fails once upstream has mended it.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, cast

from rclpy.subscription import Subscription

from im_core.processes.startup import STATUS_TOPIC

#: Topics that every node follows; a process of seven nodes read a hundred stamps a second seven times.
TOPICS = frozenset({"/clock", STATUS_TOPIC})

Follower = Callable[[Any], None]

_shared: ContextVar[dict[str, list[Follower]] | None] = ContextVar("shared", default=None)


class Share:
    """Share of a node in a reader; the reader lives as long as the first node of the topic."""


@contextmanager
def shared_readers() -> Iterator[None]:
    """Make nodes within the context share readers of :data:`TOPICS`; the nodes must end together."""
    token = _shared.set({})
    try:
        yield
    finally:
        _shared.reset(token)


def follow(topic: str, callback: Follower, make: Callable[[Follower], Subscription]) -> Subscription:
    """Follow a topic, by the reader of another node if there is one.

    Returns:
        The subscription; of a topic that is shared a :class:`Share`, which no node has and so none destroys.
    """
    shared = _shared.get()
    if shared is None or topic not in TOPICS:
        return make(callback)
    if topic in shared:
        shared[topic].append(callback)
        return cast(Subscription, Share())
    followers = shared[topic] = [callback]

    def tell(message: Any) -> None:
        for follower in followers:
            follower(message)

    make(tell)
    return cast(Subscription, Share())
