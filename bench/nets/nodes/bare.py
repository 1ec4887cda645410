"""The baseline of remote tokens: a small message that two bare nodes send back and forth.

``python -m bench.nets.nodes.bare ping|pong IDLE_SUBSCRIPTIONS events|rclpy``
"""

import sys
import threading
from functools import partial
from itertools import pairwise

from rclpy.node import Node
from std_msgs.msg import UInt64

from bench.nets.nodes.loop import PATIENCE_S, RclpySpin, run, wait_until
from bench.nets.serving import Handler
from im_core.clock import cpu, monotonic
from im_core.ros.run import Spinner

DEPTH = 10


class Pong(Node):
    """Sends back what comes; reliable, with the default depth."""

    def __init__(self, name: str) -> None:
        super().__init__(f"bench_{name}_pong")
        self._publisher = self.create_publisher(UInt64, f"/bench/{name}/pong", DEPTH)
        self.create_subscription(UInt64, f"/bench/{name}/ping", self._publisher.publish, DEPTH)


class Ping(Node):
    """Sends a message as soon as the last one is back, and notes when that was."""

    def __init__(self, name: str) -> None:
        super().__init__(f"bench_{name}_ping")
        self._pong = f"/bench/{name}/pong"
        self._publisher = self.create_publisher(UInt64, f"/bench/{name}/ping", DEPTH)
        self.create_subscription(UInt64, self._pong, self._hear, DEPTH)
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
            return self._publisher.get_subscription_count() > 0 and self.count_publishers(self._pong) > 0

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
    side, subscriptions, spin = sys.argv[1:]
    make = partial(Ping if side == "ping" else Pong, f"bare_{spin}")
    run(make, _handlers, int(subscriptions), spin=RclpySpin if spin == "rclpy" else Spinner)
