"""``record``: every topic of the ROS domain into a bag, also those that appear later, until SIGINT or SIGTERM."""

import argparse
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from im_bringup.bag import BagWriter, Delivery, default_folder
from im_core import clock
from im_core.errors import ImError, StoreError
from im_core.ros.guard import GuardedNode
from im_core.ros.interfaces import interface_class
from im_core.ros.run import Spinner

DISCOVERY_PERIOD_S = 0.5
QUEUE_DEPTH = 1000


class BagRecorder(GuardedNode):
    """Subscribes to what is published and writes the bytes as they come.

    Args:
        bag: Where to.
        only: Topics to record; empty: all that are not hidden.
    """

    def __init__(self, bag: BagWriter, only: list[str]) -> None:
        super().__init__("recorder")
        self._bag = bag
        self._only = set(only)
        self._refused: set[str] = set()
        #: Why the recording ended before it was asked to, if it did.
        self.trouble: StoreError | None = None
        self.on_trouble: Callable[[], None] = lambda: None
        self.create_timer(DISCOVERY_PERIOD_S, self.discover, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def discover(self) -> None:
        """Subscribe to topics that were not there before."""
        for topic, types in self.get_topic_names_and_types():
            if topic in self._bag.counts or topic in self._refused or not self._wanted(topic):
                continue
            publishers = self.get_publishers_info_by_topic(topic)
            if publishers:
                self._subscribe(topic, types[0], delivery_of(publishers))

    def take_rest(self) -> None:
        """Write what has arrived and was not handed out before the spinning ended."""
        for subscription in self.subscriptions:
            with subscription.handle:
                while (taken := subscription.handle.take_message(subscription.msg_type, True)) is not None:
                    subscription.callback(taken[0])

    def _wanted(self, topic: str) -> bool:
        return topic in self._only if self._only else "/_" not in topic

    def _subscribe(self, topic: str, type_name: str, delivery: Delivery) -> None:
        try:
            message_class = interface_class(type_name)
            self._bag.add_topic(topic, type_name, delivery)
        except ImError as error:
            self._refused.add(topic)
            print(f"record: {topic} is left out: {error.message}", file=sys.stderr)
            return

        def write(data: bytes) -> None:
            if self.trouble is not None:
                return
            try:
                self._bag.write(topic, int(clock.wall() * 1e9), data)
            except StoreError as error:
                self.trouble = error
                self.on_trouble()

        self.create_subscription(message_class, topic, write, to_profile(delivery), raw=True)


def delivery_of(publishers: Any) -> Delivery:
    """What all publishers of a topic offer."""
    profiles = [publisher.qos_profile for publisher in publishers]
    return Delivery(
        reliable=all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles),
        latched=all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles),
        depth=max(1, *(profile.depth for profile in profiles), 1),
    )


def to_profile(delivery: Delivery) -> QoSProfile:
    """The profile to subscribe or publish with."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=max(delivery.depth, QUEUE_DEPTH),
        reliability=ReliabilityPolicy.RELIABLE if delivery.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if delivery.latched else DurabilityPolicy.VOLATILE,
    )


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="record", description="Record topics into a bag (MCAP) until Ctrl-C.")
    parser.add_argument("-o", "--output", type=Path, help="folder of the bag (default: bags/<date>-<time>)")
    parser.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="only these (default: all)")
    arguments = parser.parse_args()
    path = (arguments.output or default_folder(clock.stamp_name())).resolve()
    try:
        bag = BagWriter(path)
    except ImError as error:
        print(f"record: {error.message}", file=sys.stderr)
        return 2
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    recorder = BagRecorder(bag, arguments.topics)
    spinner = Spinner([recorder])
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: spinner.request_stop())
    recorder.on_trouble = spinner.request_stop
    print(f"record: into {path}; Ctrl-C ends it", flush=True)
    try:
        spinner.spin()
        recorder.take_rest()
    finally:
        spinner.stop()
        rclpy.try_shutdown()
        unfinished = closed(bag)
    trouble = recorder.trouble or unfinished
    if trouble is not None:
        print(f"record: {trouble.message}", file=sys.stderr)
        return 1
    print(f"record: {sum(bag.counts.values())} messages of {len(bag.counts)} topics in {path}")
    return 0


def closed(bag: BagWriter) -> StoreError | None:
    """Finish a bag; why its last part could not be written, if it could not."""
    try:
        bag.close()
    except StoreError as error:
        return error
    return None


if __name__ == "__main__":
    sys.exit(main())
