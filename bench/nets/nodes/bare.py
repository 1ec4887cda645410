"""The baseline of remote tokens: a small message that two bare nodes send back and forth.

``python -m bench.nets.nodes.bare ping|pong IDLE_SUBSCRIPTIONS``
"""

import sys
import threading
from itertools import pairwise

from rclpy.node import Node
from std_msgs.msg import UInt64

from bench.nets.nodes.loop import PATIENCE_S, run, wait_until
from bench.nets.serving import Handler
from im_core.clock import cpu, monotonic

DEPTH = 10


class Pong(Node):
    """Sends back what comes; reliable, with the default depth."""

    def __init__(self) -> None:
        super().__init__("bench_bare_pong")
        self._publisher = self.create_publisher(UInt64, "/bench/pong", DEPTH)
        self.create_subscription(UInt64, "/bench/ping", self._publisher.publish, DEPTH)


class Ping(Node):
    """Sends a message as soon as the last one is back, and notes when that was."""

    def __init__(self) -> None:
        super().__init__("bench_bare_ping")
        self._publisher = self.create_publisher(UInt64, "/bench/ping", DEPTH)
        self.create_subscription(UInt64, "/bench/pong", self._hear, DEPTH)
        self._trips = 0
        self._times: list[float] = []
        self._done = threading.Event()

    def _hear(self, message: UInt64) -> None:
        self._times.append(monotonic())
        if len(self._times) <= self._trips:
            self._publisher.publish(message)
        else:
            self._done.set()

    def ready(self, _: dict[str, object]) -> dict[str, object]:
        """Waits for the other side."""

        def matched() -> bool:
            return self._publisher.get_subscription_count() > 0 and self.count_publishers("/bench/pong") > 0

        wait_until(matched, "the other node")
        return {}

    def play(self, request: dict[str, object]) -> dict[str, object]:
        """Makes round trips; returns how long each took [s]."""
        self._trips = int(str(request["trips"]))
        self._done.clear()
        began = cpu()
        self._times = [monotonic()]
        self._publisher.publish(UInt64(data=1))
        finished = self._done.wait(PATIENCE_S)
        times = self._times
        return {
            "finished": finished,
            "trips_s": [later - earlier for earlier, later in pairwise(times)],
            "cpu_s": cpu() - began,
        }


def _handlers(node: Node) -> dict[str, Handler]:
    return {"ready": node.ready, "play": node.play} if isinstance(node, Ping) else {}


if __name__ == "__main__":
    side, subscriptions = sys.argv[1:]
    run(Ping if side == "ping" else Pong, _handlers, int(subscriptions))
