"""``record``: every topic of the ROS domain into a bag, also those that appear later, until SIGINT or SIGTERM."""

import argparse
import signal
import sys
import threading
from pathlib import Path
from typing import Any

import rclpy
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.validate_full_topic_name import validate_full_topic_name

from im_bringup.bag import BagWriter, Delivery, default_folder
from im_core import clock
from im_core.errors import DataError, ImError, StoreError
from im_core.ros.graph import GraphWatch
from im_core.ros.guard import GuardedNode
from im_core.ros.interfaces import interface_class

QUEUE_DEPTH = 5000
#: How long messages wait in the queues of the middleware, which notes when they came, until they are on the disk [s].
#: Each time costs a look into every queue; a queue holds what comes at 10,000 messages a second.
DRAIN_PERIOD_S = 0.5
#: Topics of service events, which are hidden.
SERVICE_EVENTS = "/_service_event"


class BagRecorder:
    """Subscribes to what is published and writes the bytes as they come.

    No executor: it empties the queues of all subscriptions twice a second. The time of arrival is the middleware's.

    The middleware offers each message to all readers of a participant, one by one. So streams, which send most, have a
    participant with few others.

    Args:
        node: Its node, which nobody spins; it subscribes to streams.
        seldom: A node of another participant, for service events and what is latched.
        bag: Where to.
        only: Topics to record; empty: all that are not hidden, and the events of services.
    """

    def __init__(self, node: Node, seldom: Node, bag: BagWriter, only: list[str]) -> None:
        self._node, self._seldom, self._bag = node, seldom, bag
        self._only = set(only)
        self._refused: set[str] = set()
        self._subscriptions: dict[str, Subscription] = {}
        self._wake, self._end = threading.Event(), threading.Event()

    def record(self) -> None:
        """Record until :meth:`request_stop`.

        Raises:
            StoreError: The disk is full, or nearly so.
        """
        graph = GraphWatch(self._node, self._wake.set)
        try:
            due = clock.monotonic() + DRAIN_PERIOD_S
            while not self._end.is_set():
                if self._wake.wait(max(0.0, due - clock.monotonic())):
                    self._wake.clear()
                    self.discover()
                if clock.monotonic() >= due:
                    due = clock.monotonic() + DRAIN_PERIOD_S
                    self.drain()
                    self._bag.flush()
            self.drain()
        finally:
            graph.stop()

    def request_stop(self) -> None:
        """End :meth:`record` soon; from signal handlers, too."""
        self._end.set()
        self._wake.set()

    def discover(self) -> None:
        """Subscribe to topics that were not there before."""
        for topic, types in self._node.get_topic_names_and_types():
            if topic in self._subscriptions or topic in self._refused or not self._wanted(topic):
                continue
            publishers = self._node.get_publishers_info_by_topic(topic)
            if publishers:
                self._subscribe(topic, types[0], publishers)

    def drain(self) -> None:
        """Write what has come.

        Raises:
            StoreError: The disk is full, or nearly so.
        """
        taken = []
        for topic, subscription in self._subscriptions.items():
            handle, latest_ns = subscription.handle, 0
            with handle:
                while (message := handle.take_message(subscription.msg_type, True)) is not None:
                    latest_ns = max(latest_ns, message[1]["received_timestamp"])  # the clock may have been set back
                    taken.append((latest_ns, topic, message))
        taken.sort(key=lambda each: each[0])
        for received_ns, topic, (data, told) in taken:
            self._bag.write(topic, received_ns, data, told["source_timestamp"], told["publication_sequence_number"])

    def missing(self) -> list[str]:
        """Topics that were to be recorded, and have had no publisher."""
        return sorted(self._only - self._subscriptions.keys() - self._refused)

    def _wanted(self, topic: str) -> bool:
        if self._only:
            return topic in self._only
        return "/_" not in topic or topic.endswith(SERVICE_EVENTS)

    def _subscribe(self, topic: str, type_name: str, publishers: list[Any]) -> None:
        delivery = delivery_of(publishers)
        try:
            message_class = interface_class(type_name)
            self._bag.add_topic(topic, type_name, delivery, str(publishers[0].topic_type_hash))
        except StoreError:
            raise
        except ImError as error:
            self._refused.add(topic)
            print(f"record: {topic} is left out: {error.message}", file=sys.stderr)
            return
        node = self._seldom if delivery.latched or topic.endswith(SERVICE_EVENTS) else self._node
        self._subscriptions[topic] = node.create_subscription(
            message_class, topic, _never_called, to_profile(delivery), raw=True
        )


def _never_called(data: bytes) -> None:
    """Stands where rclpy wants a callback; no executor has the node."""


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


def check_topic_name(name: str) -> None:
    """Whether a topic can have this name.

    Raises:
        DataError: It is no full topic name, as ROS allows them.
    """
    try:
        validate_full_topic_name(name)
    except InvalidTopicNameException as error:
        reason = str(error).splitlines()[0].removeprefix("Invalid topic name: ").removesuffix(":")
        raise DataError(f"{name} is no full name of a topic: {reason}", topic=name) from error


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="record", description="Record topics into a bag (MCAP) until Ctrl-C.")
    parser.add_argument("-o", "--output", type=Path, help="folder of the bag (default: bags/<date>-<time>)")
    parser.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="only these (default: all)")
    arguments = parser.parse_args()
    for topic in arguments.topics:
        try:
            check_topic_name(topic)
        except DataError as error:
            parser.error(f"--topics: {error.message}")
    path = (arguments.output or default_folder(clock.stamp_name())).resolve()
    try:
        bag = BagWriter(path)
    except ImError as error:
        print(f"record: {error.message}", file=sys.stderr)
        return 2
    contexts = [rclpy.Context() for _ in range(2)]
    nodes: list[Any] = []
    for name, context in zip(("recorder", "recorder_of_what_is_seldom"), contexts, strict=True):
        rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
        nodes.append(GuardedNode(name, context=context, enable_rosout=False, start_parameter_services=False))
    recorder = BagRecorder(nodes[0], nodes[1], bag, arguments.topics)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: recorder.request_stop())
    print(f"record: into {path}; Ctrl-C ends it", flush=True)
    trouble: ImError | None = None
    try:
        recorder.record()
    except StoreError as error:
        trouble = error
    finally:
        for node, context in zip(nodes, contexts, strict=True):
            node.destroy_node()
            context.try_shutdown()
        unfinished = closed(bag)
    if missing := recorder.missing():
        print(f"record: nobody published on {', '.join(missing)}", file=sys.stderr)
    if (trouble := trouble or unfinished) is not None:
        print(f"record: {trouble.message}", file=sys.stderr)
        return 1
    print(f"record: {sum(bag.counts.values())} messages of {len(bag.counts)} topics in {path}")
    return 0


def closed(bag: BagWriter) -> ImError | None:
    """Finish a bag; why its last part could not be written, if it could not."""
    try:
        bag.close()
    except ImError as error:
        return error
    return None


if __name__ == "__main__":
    sys.exit(main())
