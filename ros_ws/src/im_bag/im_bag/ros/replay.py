"""``replay``: publish the messages of a bag, each on the right topic at the due time."""

import argparse
import contextlib
import operator
import os
import re
import select
import shutil
import sys
import termios
import threading
import tty
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import rclpy
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosgraph_msgs.msg import Clock

from im_bag import BagReader, BagWriter, chosen_topics
from im_bag.command_line import parsed
from im_bag.playback import KEYS, Controls, Playback
from im_bag.raw import changed_type
from im_bag.ros.recorder import check_topic_name, to_profile
from im_core import clock
from im_core.errors import DataError, ImError, NotFoundError, StateError
from im_core.options import NumberParser
from im_core.output import complain, say
from im_core.processes.end_signals import heed_end_signals
from im_core.processes.startup import PHASE_TOPIC
from im_core.ros import qos
from im_core.ros.guard import GuardedNode
from im_core.ros.messages.interfaces import message_class
from im_core.ros.peers.servers import node_of

#: Time for subscribers to find the publishers before the first message: at least, and while none has [s].
DISCOVERY_S = 1.0
DISCOVERY_AT_MOST_S = 4.0
#: Time for subscribers to take the last messages: at least, and while they have not acknowledged them [s].
DRAIN_S = 0.5
DRAIN_AT_MOST_S = 5.0
_LONGEST_SLEEP_S = 0.2
_CLOCK = "/clock"
#: What the nets of a mission are run again from, and what shows them.
MISSION_TOPICS = ("/pnt/events", "/pnt/nets", "/pnt/firings", "/pnt/markings")
#: Options of what is published, which --extract does not go with.
_PUBLISHING = ("rate", "start", "loop", "paused", "clock", "force", "remap")
_ARROWS = {"\x1b[D": "left", "\x1b[C": "right"}
#: A key as a terminal tells it: several characters where it is none of a text, or Esc alone.
_KEY = re.compile(r"\x1b\[[0-9;]*[^0-9;\x1b]|.", re.DOTALL)
_MOST_TYPED = 1024


class Replay:
    """Plays a bag.

    Args:
        node: Node that publishes.
        bag: The bag.
        topics: Topics to play; none has a type that is not known here.
        names: Other names for some of them.
        force: Play even where a machine runs in the ROS domain.

    Raises:
        DataError: A type has another definition here than when it was recorded, or a name is of another type.
    """

    def __init__(
        self, node: Node, bag: BagReader, topics: Sequence[str], names: Mapping[str, str], force: bool = False
    ) -> None:
        self._node, self._force = node, force
        self.controls = Controls()
        self._publishers: dict[str, Publisher] = {}
        for topic in topics:
            kind, name = bag.types[topic], names.get(topic, topic)
            try:
                publisher = node.create_publisher(message_class(kind), name, to_profile(bag.deliveries[topic]))
            except rclpy_implementation.RCLError as error:  # another topic has got that name, or it is one of each node
                what = topic if topic == name else f"{topic} as {name}"
                text = f"{what} cannot be of {kind}: this replay publishes another type there"
                raise DataError(f"{text}; --remap {topic}:=/NEW gives it another name", topic=topic) from error
            self._publishers[topic] = publisher
            self._check_definition(bag, topic, name)
        self._clock: Publisher | None = None
        self._told_ns: int | None = None

    def provide_clock(self) -> None:
        """Publish the time of the bag on /clock from now on."""
        self._clock = self._node.create_publisher(Clock, _CLOCK, qos.CLOCK)

    def tell_time(self, stamp_ns: int) -> None:
        """Publish a time of the bag on /clock [ns], if requested and different from the last published time."""
        if self._clock is not None and stamp_ns != self._told_ns:
            self._clock.publish(Clock(clock=Time(nanoseconds=stamp_ns).to_msg()))
            self._told_ns = stamp_ns

    def play(self, playback: Playback) -> int:
        """Publish all messages of a playback; return the number of messages.

        Raises:
            StateError: A machine runs in the ROS domain, on this host or another; nothing was published.
        """
        self._await_subscribers()
        if not self._force:
            self._require_no_machine()
        count = 0
        for topic, stamp_ns, data in playback.messages():
            self.tell_time(stamp_ns)
            self._publishers[topic].publish(data)
            count += 1
        self._sleep_until(clock.monotonic() + DRAIN_S)
        deadline = clock.monotonic() + DRAIN_AT_MOST_S
        for publisher in self._publishers.values():
            if not self.controls.ended:
                publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - clock.monotonic())))
        return count

    def _check_definition(self, bag: BagReader, topic: str, name: str) -> None:
        recorded = bag.hashes[topic]
        here = {
            str(end.topic_type_hash)
            for end in self._node.get_publishers_info_by_topic(name)
            if self._is_own(end) and end.topic_type == bag.types[topic]
        }
        if not recorded or not here:
            bag.check_definition(topic)
        elif recorded not in here:
            raise changed_type(topic, bag.types[topic])

    def _require_no_machine(self) -> None:
        """Refuse to mix a bag with the topics of a machine, known by the publisher of its phase."""
        leaders = [end for end in self._node.get_publishers_info_by_topic(PHASE_TOPIC) if not self._is_own(end)]
        if leaders:
            others = len(self._node.get_node_names()) - 1 - len(leaders)
            machine = f"a machine runs in ROS domain {self._node.context.get_domain_id()}"
            leader = f"{node_of(leaders[0])}, with {others} other nodes"
            remedy = "set another ROS_DOMAIN_ID, stop the machine, or mix the topics with --force"
            raise StateError(f"{machine} ({leader}); {remedy}")

    def _is_own(self, end: TopicEndpointInfo) -> bool:
        return bool(end.node_name == self._node.get_name())

    def _await_subscribers(self) -> None:
        began = clock.monotonic()
        self._sleep_until(began + DISCOVERY_S)
        while not self._found() and not self.controls.ended and clock.monotonic() < began + DISCOVERY_AT_MOST_S:
            self._sleep_until(clock.monotonic() + 0.05)

    def _found(self) -> bool:
        """Check whether there are subscribers, and all known subscribers are connected."""
        publishers = self._publishers.values()
        known = [self._node.count_subscribers(publisher.topic_name) for publisher in publishers]
        found = [publisher.get_subscription_count() for publisher in publishers]
        return any(known) and all(map(operator.ge, found, known))

    def _sleep_until(self, deadline: float) -> None:
        while not self.controls.ended and (left := deadline - clock.monotonic()) > 0.0:
            clock.sleep(min(left, _LONGEST_SLEEP_S))


def known_topics(bag: BagReader, topics: Sequence[str], names: Mapping[str, str], named: bool) -> list[str]:
    """Return topics with one type, known here, and a valid ROS name; each other topic is reported in a sentence.

    Args:
        bag: The bag.
        topics: Topics in it.
        names: Other names for some of them.
        named: Whether the user named them.

    Raises:
        DataError: A topic that the user named has several types, one of no messages, or a name that ROS does not allow.
        NotFoundError: It has a type that is not known here.
    """
    known = []
    for topic in topics:
        try:
            bag.check_type(topic)
            message_class(bag.types[topic])
            _check_name(topic, names)
        except (NotFoundError, DataError) as error:
            if named:
                raise
            complain(f"replay: {topic} is left out: {error.message}")
        else:
            known.append(topic)
    return known


@contextlib.contextmanager
def keys_pressed(controls: Controls) -> Iterator[None]:
    """Hand the keys of a terminal to controls; without a terminal there are none."""
    if not sys.stdin.isatty():
        yield
        return
    before, done = termios.tcgetattr(sys.stdin), threading.Event()

    def read() -> None:
        while not done.is_set():
            if select.select([sys.stdin], [], [], _LONGEST_SLEEP_S)[0]:
                try:
                    typed = os.read(sys.stdin.fileno(), _MOST_TYPED)  # not sys.stdin, which would wait for more
                except OSError:
                    return  # the terminal is gone
                if not typed:
                    return
                for key in _KEY.findall(typed.decode("ascii", "replace")):
                    controls.press(_ARROWS.get(key, key))

    tty.setcbreak(sys.stdin)
    reader = threading.Thread(target=read, name="keys", daemon=True)
    reader.start()
    try:
        yield
    finally:
        done.set()
        reader.join()
        with contextlib.suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def extract(bag: BagReader, topics: Sequence[str], folder: Path) -> int:
    """Write topics of a bag into a new one, whole or not at all; returns the number of messages.

    Args:
        bag: The bag.
        topics: Which; empty: what nets of a mission are run again from, and shown with.
        folder: Folder of the new bag.

    Raises:
        DataError: A topic is not in the bag, or nothing that a mission is run again from, or the folder exists, or a
            topic has several types, or one of another definition than here.
        StoreError: The disk is full.
    """
    if not topics and MISSION_TOPICS[0] not in bag.types:
        raise DataError(f"the bag has no messages on {MISSION_TOPICS[0]}; nets cannot be run again without them")
    chosen = chosen_topics(bag.types, topics or [topic for topic in MISSION_TOPICS if topic in bag.types])
    for topic in chosen:
        bag.check_type(topic)
        bag.check_definition(topic)
    new, counts = BagWriter(folder), dict.fromkeys(chosen, 0)
    try:
        for topic in chosen:
            new.add_topic(topic, bag.types[topic], bag.deliveries[topic], bag.hashes[topic])
        for topic, stamp_ns, data in bag.messages(chosen):
            counts[topic] += 1
            new.write(topic, stamp_ns, data, stamp_ns, counts[topic])
        new.close()
    except BaseException:
        with contextlib.suppress(ImError):
            new.close()
        shutil.rmtree(folder, ignore_errors=True)  # half a mission looks like a whole one
        raise
    return sum(counts.values())


def _check_name(topic: str, names: Mapping[str, str]) -> None:
    try:
        check_topic_name(names.get(topic, topic))
    except DataError as error:
        raise DataError(f"{error.message}; --remap {topic}:=/NEW gives it another", topic=topic) from error


def _renamed(texts: Sequence[str], parser: argparse.ArgumentParser) -> dict[str, str]:
    names: dict[str, str] = {}
    for text in texts:
        old, sign, new = text.partition(":=")
        if not (old.startswith("/") and sign and new.startswith("/")):
            parser.error(f"--remap {text} is not of the form /old:=/new")
        try:
            check_topic_name(new)
        except DataError as error:
            parser.error(f"--remap {text}: {error.message}")
        if names.setdefault(old, new) != new:
            parser.error(f"--remap gives {old} two names, {names[old]} and {new}")
    return names


def _parser() -> argparse.ArgumentParser:
    parser = NumberParser(
        prog="replay", description="Publish the messages of a bag on their topics.", epilog=f"Keys: {KEYS}."
    )
    parser.add_argument("bag", type=Path, help="folder of the bag, or a file of it")
    parser.add_argument("--rate", type=float, default=1.0, help="speed; 2 plays twice as fast (default: 1)")
    parser.add_argument("--start", type=float, default=0.0, metavar="S", help="time to begin at [s] (default: 0)")
    parser.add_argument("--loop", action="store_true", help="begin again at the end")
    parser.add_argument("--paused", action="store_true", help="begin paused")
    parser.add_argument("--clock", action="store_true", help="publish the time of the bag on /clock")
    parser.add_argument("--force", action="store_true", help="replay even where a machine runs: the topics mix")
    parser.add_argument("--remap", nargs="+", default=[], metavar="/OLD:=/NEW", help="publish topics under other names")
    parser.add_argument(
        "--topics", nargs="+", default=[], metavar="TOPIC", help="topics to publish (default: all but control)"
    )
    parser.add_argument(
        "--extract",
        type=Path,
        metavar="FOLDER",
        help="publish nothing: write the topics (default: those that --mission needs) into a small bag",
    )
    return parser


def _extracted(path: Path, topics: Sequence[str], folder: Path) -> int:
    try:
        with BagReader(path) as bag:
            count = extract(bag, topics, folder.resolve())
    except ImError as error:
        complain(f"replay: {error.message}")
        return 2
    say(f"replay: {count} messages in {folder}")
    return 0


def main() -> int:
    """Run the command."""
    parser = _parser()
    arguments = parsed(parser)
    if not 0.0 < arguments.rate <= 1000.0:
        parser.error(f"--rate {arguments.rate:g} is not in 0 ... 1000, above 0")
    names = _renamed(arguments.remap, parser)
    if arguments.extract is not None:
        given = [f"--{name}" for name in _PUBLISHING if getattr(arguments, name) != parser.get_default(name)]
        if given:
            parser.error(f"--extract publishes nothing: it does not go with {', '.join(given)}")
        return _extracted(arguments.bag, arguments.topics, arguments.extract)
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        with BagReader(arguments.bag) as bag, contextlib.ExitStack() as undo:
            chosen_topics(bag.types, names)
            wanted = [
                topic
                for topic in chosen_topics(bag.types, arguments.topics)
                if not (arguments.clock and topic == _CLOCK)
            ]
            if unused := sorted(names.keys() - set(wanted)):
                raise DataError(f"--remap {unused[0]} is not replayed; give it in --topics", topic=unused[0])
            topics = known_topics(bag, wanted, names, bool(arguments.topics))
            if not any(bag.counts[topic] for topic in topics):
                raise DataError(f"{arguments.bag} has no messages to replay")
            node = GuardedNode("replay")
            undo.callback(node.destroy_node)
            replay = Replay(node, bag, topics, names, arguments.force)
            if arguments.clock:
                replay.provide_clock()
            controls = replay.controls
            controls.paused = arguments.paused
            playback = Playback(
                bag, topics, controls, arguments.rate, arguments.start, arguments.loop, replay.tell_time
            )
            heed_end_signals(lambda _: controls.end())
            seconds = (bag.duration_s - arguments.start) / arguments.rate
            say(f"replay: {len(topics)} topics, {seconds:.1f} s")
            with keys_pressed(controls):
                count = replay.play(playback)
    except ImError as error:
        complain(f"replay: {error.message}")
        return 2
    finally:
        rclpy.try_shutdown()
    say(f"replay: {count} messages published")
    return 0


if __name__ == "__main__":
    sys.exit(main())
