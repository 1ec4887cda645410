"""``im topic``: topics of the graph, their messages and rates."""

import argparse
import queue
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile

from im_bringup.ros.client_output import DONE
from im_bringup.ros.graph.client import GraphClient, GraphParser, class_of, message_from, message_text, print_all
from im_core import clock
from im_core.errors import StateError
from im_core.options import at_least, seconds
from im_core.ros.peers.servers import node_of
from im_core.ros.qos import offered

#: Messages that wait to be shown; more than that are left out.
_DEPTH = 1000
#: Messages that reach who comes later.
_PUBLISHED = 10
_LONGEST = 128
_POLL_S = 0.02


def parser() -> GraphParser:
    """The arguments of the command."""
    example = "im topic echo /joint_states --once"
    found = GraphParser("topic", "Show the topics of the ROS graph, listen to one, publish on one.", example)
    found.list_verb()
    found.verb("type", _type, "print the type of a topic", "topic_name")
    info = found.verb("info", _info, "print type, publishers and subscriptions of a topic", "topic_name")
    info.add_argument("-v", "--verbose", action="store_true", help="name the nodes, and their qualities of service")
    echo = found.verb("echo", _echo, "print the messages of a topic as YAML", "topic_name")
    echo.add_argument("message_type", nargs="?", help="e.g. std_msgs/msg/String (default: that of the graph)")
    echo.add_argument("--once", action="store_true", help="print the first message only")
    echo.add_argument("-f", "--full-length", action="store_true", help="cut no texts and lists")
    echo.add_argument(
        "-l",
        "--truncate-length",
        type=at_least(0),
        default=_LONGEST,
        metavar="N",
        help="cut texts and lists behind N characters or elements (default: %(default)s)",
    )
    rate = found.verb("hz", _hz, "print how often messages come, each second", "topic_name")
    rate.add_argument(
        "-w", "--window", type=at_least(2), default=10_000, metavar="N", help="newest messages that count (%(default)s)"
    )
    pub = found.verb("pub", _pub, "publish a message", "topic_name", "message_type")
    pub.add_argument("values", nargs="?", default="{}", help="its fields as YAML, e.g. '{data: 1.5}'")
    pub.add_argument(
        "-r", "--rate", type=seconds, default=1.0, metavar="HZ", help="messages a second (default: %(default)g)"
    )
    often = pub.add_mutually_exclusive_group()
    often.add_argument("-1", "--once", dest="times", action="store_const", const=1, help="publish one message")
    often.add_argument("-t", "--times", type=at_least(1), metavar="N", help="publish N messages (default: no end)")
    pub.add_argument(
        "-w",
        "--wait-matching-subscriptions",
        type=at_least(0),
        metavar="N",
        help="subscriptions to wait for first (default: 1 with --once or --times, else 0)",
    )
    return found


def rate_text(stamps: Sequence[float]) -> str:
    """Return rate and intervals of messages as text.

    Args:
        stamps: When each came [s]; at least two.
    """
    steps = np.diff(stamps)
    return (
        f"average rate: {1.0 / steps.mean():.3f}\n\tmin: {steps.min():.3f}s max: {steps.max():.3f}s "
        f"std dev: {steps.std():.5f}s window: {len(stamps)}"
    )


def _type(node: GraphClient, options: argparse.Namespace) -> int:
    return print_all([node.find("topic", options.topic_name, options.timeout)])


def _info(node: GraphClient, options: argparse.Namespace) -> int:
    name = options.topic_name
    type_name = node.find("topic", name, options.timeout)
    node.listed("node")  # names of nodes come after their topics
    print(f"Type: {type_name}\n")
    for title, ends in (
        ("Publisher", node.get_publishers_info_by_topic(name)),
        ("Subscription", node.get_subscriptions_info_by_topic(name)),
    ):
        print(f"{title} count: {len(ends)}")
        for end in ends if options.verbose else ():
            profile = end.qos_profile
            qualities = f"{profile.reliability.name}, {profile.durability.name}"
            print(f"  {node_of(end)}: {qualities}")
    return DONE


def _echo(node: GraphClient, options: argparse.Namespace) -> int:
    name = options.topic_name
    kind = class_of(options.message_type or node.find("topic", name, options.timeout))
    messages = _subscribed(node, name, kind)
    node.wait(lambda: not messages.empty(), f"a message on {name}", options.timeout)
    longest = None if options.full_length else options.truncate_length
    while True:
        while not messages.empty():
            print(f"{message_text(messages.get()[1], longest)}---", flush=True)
            if options.once:
                return DONE
        node.pause(_POLL_S)


def _hz(node: GraphClient, options: argparse.Namespace) -> int:
    name = options.topic_name
    messages = _subscribed(node, name, class_of(node.find("topic", name, options.timeout)), timed=True)
    stamps: list[float] = []
    while True:
        node.wait(lambda: not messages.empty(), f"a message on {name}", options.timeout)
        node.pause(1.0)
        while not messages.empty():
            stamps.append(messages.get()[0])
        stamps = stamps[-options.window :]
        if len(stamps) > 1:
            print(rate_text(stamps), flush=True)


def _subscribed(node: GraphClient, name: str, kind: Any, timed: bool = False) -> "queue.Queue[tuple[float, Any]]":
    """Subscribe to a topic; return its messages, each with the time it came at.

    Where only the times count, messages are not decoded, and those from before, which come all at once, left out.
    """
    messages: queue.Queue[tuple[float, Any]] = queue.Queue(_DEPTH)

    def keep(message: Any) -> None:
        if not messages.full():
            messages.put((clock.monotonic(), message))

    profile = offered(node.get_publishers_info_by_topic(name), _DEPTH)
    if timed:
        profile.durability = DurabilityPolicy.VOLATILE
    node.create_subscription(kind, name, keep, profile, raw=timed)
    return messages


def _pub(node: GraphClient, options: argparse.Namespace) -> int:
    kind = class_of(options.message_type)
    message = message_from(kind(), options.values, options.message_type)
    profile = QoSProfile(depth=_PUBLISHED, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = node.create_publisher(kind, options.topic_name, profile)
    wanted = options.wait_matching_subscriptions
    if wanted is None:
        wanted = 1 if options.times else 0
    what = f"{wanted} subscription{'s' if wanted > 1 else ''} of {options.topic_name}"
    node.wait(lambda: publisher.get_subscription_count() >= wanted, what, options.timeout)
    number = 0
    while True:
        number += 1
        print(f"publishing #{number}: {options.values}", flush=True)
        publisher.publish(message)
        if number == options.times:
            break
        node.pause(1.0 / options.rate)
    if not publisher.wait_for_all_acked(Duration(seconds=options.timeout)):
        raise StateError(f"not every subscription of {options.topic_name} has acknowledged the last message")
    return DONE


def main() -> int:
    """Run the command."""
    return parser().run()


if __name__ == "__main__":
    sys.exit(main())
