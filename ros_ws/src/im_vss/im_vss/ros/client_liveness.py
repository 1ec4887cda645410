"""Presence of the clients of a Service."""

from collections.abc import Callable

from rclpy.node import Node

from im_core import clock

_CACHE_S = 0.2


class Askers:
    """Counts the clients of a service in the ROS graph.

    A request does not say in Python which client it is from; so the death of a client is certain only when no client of
    its Service is left. Until then the leases of its request end with its result or their deadline.
    """

    def __init__(self, node: Node, service: str) -> None:
        """Watch the clients of `service`."""
        self._node = node
        self._service = service
        self._counted = -1.0
        self._count = 0

    def present(self) -> Callable[[], bool]:
        """Return a function for one request: False from the departure of all seen clients of the Service on."""
        seen = False

        def alive() -> bool:
            nonlocal seen
            count = self._clients()
            seen = seen or count > 0
            return count > 0 or not seen

        return alive

    def _clients(self) -> int:
        now = clock.monotonic()
        if now - self._counted > _CACHE_S:
            self._counted, self._count = now, self._node.count_clients(self._service)
        return self._count
