"""``record``: record all topics of the ROS domain, also later ones, into a bag until an end signal."""

import argparse
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import rclpy
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.validate_full_topic_name import validate_full_topic_name

from im_bag import BagWriter, Delivery, default_folder
from im_core import clock
from im_core.errors import DataError, ImError, StoreError
from im_core.output import complain, say
from im_core.processes.end_signals import heed_end_signals
from im_core.ros.guard import GuardedNode
from im_core.ros.messages.interfaces import interface_class
from im_core.ros.peers.graph import GraphWatch
from im_core.ros.qos import offered

QUEUE_DEPTH = 5000
#: How long messages wait in the queues of the middleware, which notes when they came, until they are on the disk [s].
#: Each time costs a look into every queue; a queue holds what comes at 10,000 messages a second.
DRAIN_PERIOD_S = 0.5
#: How long a subscription is kept beside the weaker one that takes its place: after that knows all publishers, who may
#: know of it a little later, and if it does not come to know them [s].
HANDOVER_S = 1.0
HANDOVER_AT_MOST_S = 5.0
#: A recorder says that it records once all publishers are connected; where none is found, and where some are not
#: connected, after so long [s].
ALONE_AFTER_S, SETTLED_AFTER_S = 2.0, 5.0
#: Topics of service events, which are hidden.
SERVICE_EVENTS = "/_service_event"
#: Ends of topics with the images of others once more, as image_transport and image_proc name them.
DERIVED_IMAGES = ("/image_raw/compressed", "/image_rect")


Taken = tuple[int, bytes, dict[str, int]]
"""A message: when it came [ns], its bytes, and what the middleware tells of it."""


class RecordedTopic:
    """Topic with a subscription and, for a moment, the earlier subscriptions replaced by a weaker one.

    A subscription that asks for more than a publisher offers gets nothing of it. So it is made anew where a publisher
    comes that offers less; until the new one is connected both get the same messages, of which one is passed on.

    All are of one node, whose participant gives a message to all of them at once.
    """

    def __init__(self, node: Node, topic: str, type_name: str, delivery: Delivery) -> None:
        self.type_name, self.delivery = type_name, delivery
        self.has_other_types = False
        self._node, self._topic = node, topic
        self._ends: list[Subscription] = []
        self._passed_on: set[tuple[int, int, bytes]] = set()
        self._until = 0.0

    def subscribe(self) -> None:
        """Subscribe, or do so anew."""
        profile = to_profile(self.delivery)
        if self._ends:
            profile.durability = DurabilityPolicy.VOLATILE  # what is latched was got before
            self._until = clock.monotonic() + HANDOVER_AT_MOST_S
        self._ends.append(
            self._node.create_subscription(
                interface_class(self.type_name), self._topic, _never_called, profile, raw=True
            )
        )

    def is_connected(self, publishers: int | None = None) -> bool:
        """Whether the subscription is connected to so many publishers; None: to all of its type."""
        wanted = self._count_publishers() if publishers is None else publishers
        return bool(self._ends[-1].handle.get_publisher_count() >= wanted)

    def take(self) -> Iterator[Taken]:
        """Yield the received messages, each once; the messages of one publisher stay in order."""
        replaced = len(self._ends) > 1
        if not replaced and not self._passed_on:
            yield from _taken(self._ends[0])
            return
        now = clock.monotonic()
        if replaced and self.is_connected():
            self._until = min(self._until, now + HANDOVER_S)
        newest_first = [list(_taken(subscription)) for subscription in reversed(self._ends)]
        for messages in reversed(newest_first):  # the oldest, looked at last, has what the others had and what preceded
            for message in messages:
                _, data, told = message
                key = (told["source_timestamp"], told["publication_sequence_number"], data)
                if key not in self._passed_on:
                    self._passed_on.add(key)
                    yield message
        if not replaced:
            self._passed_on.clear()
        elif now > self._until:
            for subscription in self._ends[:-1]:
                self._node.destroy_subscription(subscription)
            del self._ends[:-1]

    def _count_publishers(self) -> int:
        return len(_of_type(self.type_name, self._node.get_publishers_info_by_topic(self._topic)))


class BagRecorder:
    """Recorder: subscribes to all published topics and writes the bytes as received.

    No executor: it empties the queues of all subscriptions twice a second. The time of arrival is the middleware's.

    The middleware offers each message to all readers of a participant, one by one. So streams, which send most, have a
    participant with few others.

    Args:
        node: Its node, which nobody spins; it subscribes to streams.
        seldom: A node of another participant, for service events and what is latched.
        bag: Where to.
        only: Topics to record; empty: all that are not hidden, and the events of services, but no images twice.
    """

    def __init__(self, node: Node, seldom: Node, bag: BagWriter, only: list[str]) -> None:
        self._node, self._seldom, self._bag = node, seldom, bag
        self._only = set(only)
        self._refused: set[str] = set()
        self._topics: dict[str, RecordedTopic] = {}
        self._seen = 0
        self._wake, self._end = threading.Event(), threading.Event()

    def record(self, begun: Callable[[], None]) -> None:
        """Record until :meth:`request_stop`.

        Args:
            begun: Called once all present publishers are connected: what they send from then on is recorded.

        Raises:
            StoreError: The disk is full, or nearly so.
        """
        graph = GraphWatch(self._node, self._wake.set)
        try:
            due = clock.monotonic() + DRAIN_PERIOD_S
            settled, began = False, clock.monotonic()
            while not self._end.is_set():
                if self._wake.wait(max(0.0, due - clock.monotonic())):
                    self._wake.clear()
                    self.discover()
                if clock.monotonic() >= due:
                    due = clock.monotonic() + DRAIN_PERIOD_S
                    self.drain()
                    self._bag.flush()
                    if not settled and (settled := self._is_settled(due - began)):
                        begun()
            self.drain()
        finally:
            graph.stop()

    def _is_settled(self, after_s: float) -> bool:
        """Whether the topics are those of the last call, and all connected, or the time for that is over."""
        before, self._seen = self._seen, len(self._topics)
        same = before == self._seen and (before > 0 or after_s >= ALONE_AFTER_S)
        return after_s >= SETTLED_AFTER_S or (same and all(topic.is_connected() for topic in self._topics.values()))

    def request_stop(self) -> None:
        """End :meth:`record` soon; from any thread."""
        self._end.set()
        self._wake.set()

    def discover(self) -> None:
        """Subscribe to new topics; subscribe again where a publisher offers less than the earlier publishers."""
        for topic, _ in self._node.get_topic_names_and_types():
            if topic in self._refused or not self._wanted(topic):
                continue
            recorded = self._topics.get(topic)
            if recorded is not None and recorded.is_connected(self._node.count_publishers(topic)):
                continue
            publishers = self._node.get_publishers_info_by_topic(topic)
            if recorded is not None:
                self._follow(topic, recorded, publishers)
            elif publishers:
                self._subscribe(topic, publishers)

    def drain(self) -> None:
        """Write the received messages.

        Raises:
            StoreError: The disk is full, or nearly so.
        """
        taken: list[tuple[str, Taken]] = []
        for topic, recorded in self._topics.items():
            taken += [(topic, message) for message in recorded.take()]
        taken.sort(key=lambda each: each[1][0])
        for topic, (received_ns, data, told) in taken:
            self._bag.write(topic, received_ns, data, told["source_timestamp"], told["publication_sequence_number"])

    def missing(self) -> list[str]:
        """Return the topics requested for recording and still without any publisher."""
        return sorted(self._only - self._topics.keys() - self._refused)

    def _wanted(self, topic: str) -> bool:
        if self._only:
            return topic in self._only
        return ("/_" not in topic and not topic.endswith(DERIVED_IMAGES)) or topic.endswith(SERVICE_EVENTS)

    def _subscribe(self, topic: str, publishers: list[Any]) -> None:
        type_name, type_hash = publishers[0].topic_type, str(publishers[0].topic_type_hash)
        delivery = delivery_of(_of_type(type_name, publishers))
        is_seldom = delivery.latched or topic.endswith(SERVICE_EVENTS)
        recorded = RecordedTopic(self._seldom if is_seldom else self._node, topic, type_name, delivery)
        try:
            interface_class(type_name)
            self._bag.add_topic(topic, type_name, recorded.delivery, type_hash)
        except StoreError:
            raise
        except ImError as error:
            self._refused.add(topic)
            complain(f"record: {topic} is left out: {error.message}")
            return
        self._topics[topic] = recorded
        recorded.subscribe()
        self._follow(topic, recorded, publishers)

    def _follow(self, topic: str, recorded: RecordedTopic, publishers: list[Any]) -> None:
        """Subscribe again if a publisher offers less; report once if publishers have another type."""
        others = {publisher.topic_type for publisher in publishers} - {recorded.type_name}
        if others and not recorded.has_other_types:
            recorded.has_other_types = True
            told = f"only {recorded.type_name} is recorded, not {', '.join(sorted(others))}, also published there"
            complain(f"record: {topic}: {told}")
        before = recorded.delivery
        now = weaker(before, delivery_of(_of_type(recorded.type_name, publishers)))
        if (now.reliable, now.latched) != (before.reliable, before.latched):
            recorded.delivery = now
            recorded.subscribe()


def _taken(subscription: Subscription) -> Iterator[Taken]:
    handle, latest_ns = subscription.handle, 0
    with handle:
        while (message := handle.take_message(subscription.msg_type, True)) is not None:
            data, told = message
            latest_ns = max(latest_ns, told["received_timestamp"])  # the clock may have been set back
            yield latest_ns, data, told


def _of_type(type_name: str, publishers: list[Any]) -> list[Any]:
    return [publisher for publisher in publishers if publisher.topic_type == type_name]


def _never_called(data: bytes) -> None:
    """Serve as the callback required by rclpy; never called, since no executor has the node."""


def delivery_of(publishers: Any) -> Delivery:
    """Return the delivery offered by all publishers of a topic."""
    profile = offered(publishers)
    reliable = profile.reliability == ReliabilityPolicy.RELIABLE
    return Delivery(reliable, profile.durability == DurabilityPolicy.TRANSIENT_LOCAL, profile.depth)


def weaker(one: Delivery, other: Delivery) -> Delivery:
    """Return the delivery offered by both."""
    return Delivery(one.reliable and other.reliable, one.latched and other.latched, max(one.depth, other.depth))


def to_profile(delivery: Delivery) -> QoSProfile:
    """The profile to subscribe or publish with."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=max(delivery.depth, QUEUE_DEPTH),
        reliability=ReliabilityPolicy.RELIABLE if delivery.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if delivery.latched else DurabilityPolicy.VOLATILE,
    )


def check_topic_name(name: str) -> None:
    """Refuse a name not allowed for a topic.

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
    parser.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="topics to record (default: all)")
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
        complain(f"record: {error.message}")
        return 2
    contexts = [rclpy.Context() for _ in range(2)]
    nodes: list[Any] = []
    for name, context in zip(("recorder", "recorder_of_what_is_seldom"), contexts, strict=True):
        rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
        nodes.append(GuardedNode(name, context=context, enable_rosout=False, start_parameter_services=False))
    recorder = BagRecorder(nodes[0], nodes[1], bag, arguments.topics)
    heed_end_signals(lambda _: recorder.request_stop())
    trouble: ImError | None = None
    try:
        recorder.record(lambda: say(f"record: into {path}; Ctrl-C ends it"))
    except StoreError as error:
        trouble = error
    finally:
        for node, context in zip(nodes, contexts, strict=True):
            node.destroy_node()
            context.try_shutdown()
        unfinished = closed(bag)
    if missing := recorder.missing():
        complain(f"record: nobody published on {', '.join(missing)}")
    if (trouble := trouble or unfinished) is not None:
        complain(f"record: {trouble.message}")
        return 1
    say(f"record: {sum(bag.counts.values())} messages of {len(bag.counts)} topics in {path}")
    return 0


def closed(bag: BagWriter) -> ImError | None:
    """Finish a bag; return the error if the last part could not be written."""
    try:
        bag.close()
    except ImError as error:
        return error
    return None


if __name__ == "__main__":
    sys.exit(main())
