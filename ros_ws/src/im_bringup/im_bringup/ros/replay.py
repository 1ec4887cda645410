"""``replay``: publish the messages of a bag on their topics, at their pace."""

import argparse
import signal
import sys
import threading
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions

from im_bringup.bag import BagReader, chosen_topics
from im_bringup.ros.record import message_class_of, to_profile
from im_core import clock
from im_core.errors import ImError

#: Time for subscribers to find the publishers before the first message, and to take the last [s].
DISCOVERY_S = 1.0
DRAIN_S = 0.5
_LONGEST_SLEEP_S = 0.2


class Replay:
    """Plays a bag.

    Args:
        node: Node that publishes.
        bag: The bag.
        topics: Topics to play.
    """

    def __init__(self, node: Node, bag: BagReader, topics: list[str]) -> None:
        self._bag = bag
        self._stop = threading.Event()
        self._publishers: dict[str, Publisher] = {
            topic: node.create_publisher(message_class_of(bag.types[topic]), topic, to_profile(bag.deliveries[topic]))
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
        self._sleep_until(clock.monotonic() + DISCOVERY_S)
        count, first_ns, began = 0, None, clock.monotonic()
        for topic, stamp_ns, data in self._bag.messages(self._publishers):
            first_ns = stamp_ns if first_ns is None else first_ns
            self._sleep_until(began + (stamp_ns - first_ns) * 1e-9 / rate)
            if self._stop.is_set():
                break
            self._publishers[topic].publish(data)
            count += 1
        self._sleep_until(clock.monotonic() + DRAIN_S)
        return count

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
            replay = Replay(Node("replay"), bag, topics)
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
