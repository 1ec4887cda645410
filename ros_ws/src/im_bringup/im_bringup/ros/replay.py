"""``replay``: publish the messages of a bag on their topics, at their pace."""

import argparse
import signal
import sys
import threading
from pathlib import Path

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions

from im_bringup.bag import BagReader, chosen_topics
from im_bringup.ros.record import to_profile
from im_core import clock
from im_core.errors import ImError
from im_core.ros.guard import GuardedNode
from im_core.ros.interfaces import interface_class

#: Time for subscribers to find the publishers before the first message: at least, and while none has [s].
DISCOVERY_S = 1.0
DISCOVERY_AT_MOST_S = 4.0
#: Time for subscribers to take the last messages: at least, and while they have not acknowledged them [s].
DRAIN_S = 0.5
DRAIN_AT_MOST_S = 5.0
_LONGEST_SLEEP_S = 0.2


class Replay:
    """Plays a bag.

    Args:
        node: Node that publishes.
        bag: The bag.
        topics: Topics to play.
    """

    def __init__(self, node: Node, bag: BagReader, topics: list[str]) -> None:
        self._node, self._bag = node, bag
        self._stop = threading.Event()
        self._publishers: dict[str, Publisher] = {
            topic: node.create_publisher(interface_class(bag.types[topic]), topic, to_profile(bag.deliveries[topic]))
            for topic in topics
        }

    def request_stop(self) -> None:
        """End :meth:`play` soon."""
        self._stop.set()

    def play(self, rate: float) -> int:
        """Publish all messages.

        Args:
            rate: Speed; 2 plays twice as fast.

        Returns:
            Number of messages published.
        """
        self._await_subscribers()
        count, first_ns, began = 0, None, clock.monotonic()
        for topic, stamp_ns, data in self._bag.messages(self._publishers):
            first_ns = stamp_ns if first_ns is None else first_ns
            self._sleep_until(began + (stamp_ns - first_ns) * 1e-9 / rate)
            if self._stop.is_set():
                break
            self._publishers[topic].publish(data)
            count += 1
        self._sleep_until(clock.monotonic() + DRAIN_S)
        deadline = clock.monotonic() + DRAIN_AT_MOST_S
        for publisher in self._publishers.values():
            if not self._stop.is_set():
                publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - clock.monotonic())))
        return count

    def _await_subscribers(self) -> None:
        began = clock.monotonic()
        self._sleep_until(began + DISCOVERY_S)
        while not self._found() and not self._stop.is_set() and clock.monotonic() < began + DISCOVERY_AT_MOST_S:
            self._sleep_until(clock.monotonic() + 0.05)

    def _found(self) -> bool:
        """Whether there are subscribers, and all that are known of are connected."""
        known = {topic: self._node.count_subscribers(topic) for topic in self._publishers}
        connected = (self._publishers[topic].get_subscription_count() >= count for topic, count in known.items())
        return any(known.values()) and all(connected)

    def _sleep_until(self, deadline: float) -> None:
        while not self._stop.is_set() and (left := deadline - clock.monotonic()) > 0.0:
            clock.sleep(min(left, _LONGEST_SLEEP_S))


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="replay", description="Publish the messages of a bag on their topics.")
    parser.add_argument("bag", type=Path, help="folder of the bag")
    parser.add_argument("--rate", type=float, default=1.0, help="speed; 2 plays twice as fast (default: 1)")
    parser.add_argument(
        "--topics", nargs="+", default=[], metavar="TOPIC", help="only these (default: all but control)"
    )
    arguments = parser.parse_args()
    if not 0.0 < arguments.rate <= 1000.0:
        parser.error(f"--rate {arguments.rate:g} is not in 0 ... 1000, above 0")
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        with BagReader(arguments.bag) as bag:
            topics = chosen_topics(bag.types, arguments.topics)
            replay = Replay(GuardedNode("replay"), bag, topics)
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, lambda *_: replay.request_stop())
            print(f"replay: {len(topics)} topics, {bag.duration_s / arguments.rate:.1f} s", flush=True)
            count = replay.play(arguments.rate)
    except ImError as error:
        print(f"replay: {error.message}", file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    print(f"replay: {count} messages published")
    return 0


if __name__ == "__main__":
    sys.exit(main())
