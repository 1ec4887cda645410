"""A recording beside a machine in real time: how much, at what cost, and what is missing."""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import rclpy
from mcap.reader import make_reader
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from bench.bag.numbers import Numbers
from bench.bag.recorder import recorder
from bench.figures import Line
from bench.machine.command import START_S, Bench
from bench.sizes.commands import poses_file
from bench.usage import cpu_s
from im_bag.files import parts
from im_bringup.machine import stop
from im_bringup.machine.start import start
from im_bringup.tasks import deployment as deployments
from im_core import clock
from im_core.errors import StateError
from im_core.ros.peers.graph import GraphWatch
from im_core.ros.run import Spinner

#: Poses of the command that goes on meanwhile, again and again; fewer do not calibrate the cameras.
POSES = 12
#: Time that the recorder has to subscribe before it counts [s].
SETTLE_S = 3.0
#: Most of a core that recording may take.
MOST = 0.05


class Publishers:
    """Who publishes on each topic, at the beginning and since."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._seen: dict[str, set[bytes]] = defaultdict(set)
        self._before: Mapping[str, int] = {}

    def look(self) -> None:
        """Takes in who is there now."""
        for topic, _ in self._node.get_topic_names_and_types():
            ends = self._node.get_publishers_info_by_topic(topic)
            self._seen[topic] |= {bytes(end.endpoint_gid) for end in ends}

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Takes in whoever comes; those that are there now were there before."""
        self.look()
        self._before = {topic: len(ends) for topic, ends in self._seen.items()}
        watch = GraphWatch(self._node, self.look)
        try:
            yield
        finally:
            watch.stop()

    def before(self, topic: str) -> int:
        """How many there were at the beginning."""
        return self._before.get(topic, 0)

    def known(self, topic: str) -> int:
        """How many there have been."""
        return len(self._seen[topic])


def recording_lines(seconds: float, seed: int, port: int, folder: Path) -> list[Line]:
    """Record all topics of a machine in real time that calibrates again and again.

    Args:
        seconds: For how long at least; the command that is under way is ended [s].
        seed: Of the testbed.
        port: Of the display.
        folder: For the bag.

    Raises:
        ImError: The machine or the recorder does not start, or a command fails.
    """
    path, bag = deployments.default_path(), folder / "bag"
    if start(deployments.load(path).with_values(clock_factor=1.0, seed=seed, port=port), path, START_S) != 0:
        raise StateError("the machine did not start")
    try:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        bench = Bench()
        publishers = Publishers(bench)
        with Spinner([bench]), publishers.watched(), recorder(bag) as process:
            clock.sleep(SETTLE_S)
            began, spent_s = clock.monotonic(), cpu_s(process.pid)
            while clock.monotonic() - began < seconds:
                bench.command(poses_file(POSES, folder))
            cost = (cpu_s(process.pid) - spent_s) / (clock.monotonic() - began)
    finally:
        rclpy.try_shutdown()
        stop.stop(say=lambda _: None)
    topics, duration_s = recorded(bag)
    one = {topic for topic in topics if publishers.known(topic) <= 1}
    messages = sum(numbers.count for numbers in topics.values())
    return [
        Line(f"recorded in {duration_s:.0f} s, {len(topics)} topics", messages / duration_s, "1/s"),
        gap_line("one publisher", {topic: topics[topic] for topic in one}, publishers),
        gap_line("several publishers", {topic: topics[topic] for topic in topics.keys() - one}, publishers),
        Line("recorder, CPU time a second", cost, "s", bar=MOST),
    ]


def gap_line(whose: str, topics: Mapping[str, Numbers], publishers: Publishers) -> Line:
    """How many gaps there are in the numbers of some topics."""
    gaps = {topic: n.gaps(publishers.before(topic), publishers.known(topic)) for topic, n in topics.items()}
    worst = [f"{topic} {count}" for topic, count in sorted(gaps.items()) if count]
    messages = sum(numbers.count for numbers in topics.values())
    where = f"of {messages:,} messages of {len(topics)} topics" + (f": {', '.join(worst[:5])}" if worst else "")
    return Line(f"gaps, topics of {whose}", float(sum(gaps.values())), "", None, where, 0.0)


def recorded(bag: Path) -> tuple[dict[str, Numbers], float]:
    """The numbers of the messages of each topic of a bag, and its duration [s]."""
    topics: dict[str, Numbers] = defaultdict(Numbers)
    stamps: list[int] = []
    for part in parts(bag):
        with part.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                topics[channel.topic].take(message.sequence)
                stamps.append(message.log_time)
    return topics, (max(stamps) - min(stamps)) * 1e-9
