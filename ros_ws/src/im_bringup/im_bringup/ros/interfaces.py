"""``interfaces``: ROS interfaces of a running machine, as the tables of ``docs/interfaces.md``."""

import argparse
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress

from rcl_interfaces.msg import ParameterDescriptor
from rcl_interfaces.srv import DescribeParameters, ListParameters
from rclpy.node import Node, NodeNameNonExistentError

from im_bringup.ros.client_output import DONE
from im_bringup.ros.interruptible import InterruptibleNode, talk
from im_core import clock

# the graph is known when nothing has changed for so long; on a busy computer that takes its time
SETTLED_S = 3.0
DISCOVERY_AT_MOST_S = 30.0
_LOOK_S = 0.5
ACTION = "/_action/"
#: How a node tells which parameters it has; one that only listens, as a recorder, may do without.
LISTING = "/list_parameters"
#: What every ROS node has, and what is worth no line.
COMMON = ("/describe_parameters", "/get_parameter", LISTING, "/set_parameters", "/get_type_description")
COMMON_TOPICS = ("/parameter_events", "/rosout")
HEAD = """\
# Interfaces

What the running machine offers, written by `scripts/run.sh im_bringup interfaces > docs/interfaces.md` when it had run
`calibrate_camera` and `close_gripper`: who writes to `/<node>/tokens` comes with his first token. The services that
every ROS node has are left out. Each interface's own file, in `ros_ws/src/im_msgs`, says what its fields mean and in
which unit.
"""
_TYPES = ("", "bool", "integer", "double", "string")
#: So many nodes are "all".
_MANY = 6
CALL_S = 30.0


def tables(node: InterruptibleNode) -> str:
    """Return the page made from the current ROS graph."""
    owners: dict[str, set[str]] = {}
    listeners: dict[str, set[str]] = {}
    for name, space in node.get_node_names_and_namespaces():
        if name.startswith(("_", node.get_name())):
            continue
        whole = f"{space.rstrip('/')}/{name}"
        with suppress(NodeNameNonExistentError):  # it has gone meanwhile
            offered = [*node.get_service_names_and_types_by_node(name, space)]
            offered += node.get_publisher_names_and_types_by_node(name, space)
            heard = node.get_subscriber_names_and_types_by_node(name, space)
            for interface, _ in offered:
                owners.setdefault(interface, set()).add(whole)
            for topic, _ in heard:
                listeners.setdefault(topic, set()).add(whole)
    services, actions, topics, driven = [], [], [], []
    for name, types in node.get_service_names_and_types():
        if ACTION in name:
            if name.endswith("/send_goal"):
                action = name.partition(ACTION)[0]
                actions.append((action, types[0].removesuffix("_SendGoal"), owners.get(name, set())))
        elif name in owners and not any(common in name for common in COMMON):
            services.append((name, types[0], owners[name]))
    for name, types in node.get_topic_names_and_types():
        if name in COMMON_TOPICS or ACTION in name or name.endswith("_event"):
            continue
        if name in owners:
            topics.append((name, types[0], owners[name]))
        elif name in listeners:
            driven.append((name, types[0], listeners[name]))
    parts = [HEAD, _table("Actions", "of", actions), _table("Services", "of", services)]
    described = [whole for whole in sorted(set().union(*owners.values())) if f"{whole}{LISTING}" in owners]
    parts.append(_parameters(_described(node, described)))
    parts += [_table("Topics", "published by", topics), _table("Topics that wait for a publisher", "heard by", driven)]
    return "\n".join(parts)


def _described(node: InterruptibleNode, owners: Iterable[str]) -> dict[tuple[str, str, str, str, str], set[str]]:
    """Return name, type, range, time of effect and description of every node parameter, with the owning nodes.

    Raises:
        WaitTimeoutError: A node does not tell its parameters.
    """
    rows: dict[tuple[str, str, str, str, str], set[str]] = {}
    for owner in owners:
        listing = node.create_client(ListParameters, f"{owner}{LISTING}")
        listed = node.ask(listing, ListParameters.Request(), CALL_S)
        telling = node.create_client(DescribeParameters, f"{owner}/describe_parameters")
        request = DescribeParameters.Request(names=listed.result.names)
        for told in node.ask(telling, request, CALL_S).descriptors:
            acts = "at the start" if told.read_only else "at any time"
            row = told.name, _TYPES[told.type], _range(told), acts, told.description
            rows.setdefault(row, set()).add(owner)
    return rows


def _range(told: ParameterDescriptor) -> str:
    spans = [f"{span.from_value:g} to {span.to_value:g}" for span in told.floating_point_range]
    spans += [f"{span.from_value} to {span.to_value}" for span in told.integer_range]
    return ", ".join(spans) or told.additional_constraints


def _parameters(rows: Mapping[tuple[str, str, str, str, str], set[str]]) -> str:
    lines = ["## Parameters", "", "| name | type | allowed | acts | what | of |", "|---|---|---|---|---|---|"]
    for (name, *told), nodes in sorted(rows.items(), key=lambda item: (len(item[1]) < _MANY, sorted(item[1]), item[0])):
        lines.append(f"| `{name}` | {' | '.join(told)} | {_whose(nodes)} |")
    return "\n".join([*lines, ""])


def _whose(nodes: set[str]) -> str:
    return ", ".join(f"`{node}`" for node in sorted(nodes)) if len(nodes) < _MANY else "all nodes"


def settle(node: InterruptibleNode, settled_s: float = SETTLED_S) -> None:
    """Wait for the end of discovery: until the graph has not changed for some seconds."""
    graph, since = _graph(node), clock.monotonic()
    deadline = since + DISCOVERY_AT_MOST_S
    while (now := clock.monotonic()) - since < settled_s and now < deadline:
        node.pause(_LOOK_S)
        before, graph = graph, _graph(node)
        since = since if graph == before else clock.monotonic()


def _graph(node: Node) -> list[tuple[str, str, int]]:
    """Return every node and the number of services, publishers and subscriptions of the node."""
    ways = (
        node.get_service_names_and_types_by_node,
        node.get_publisher_names_and_types_by_node,
        node.get_subscriber_names_and_types_by_node,
    )
    graph = []
    for name, space in node.get_node_names_and_namespaces():
        with suppress(NodeNameNonExistentError):  # it has gone meanwhile
            graph.append((name, space, sum(len(way(name, space)) for way in ways)))
    return sorted(graph)


def _table(title: str, owned: str, rows: Iterable[tuple[str, str, set[str]]]) -> str:
    lines = [f"## {title}", "", f"| name | type | {owned} |", "|---|---|---|"]
    for name, kind, nodes in sorted(rows):
        lines.append(f"| `{name}` | `{kind}` | {_whose(nodes)} |")
    return "\n".join([*lines, ""])


def main() -> int:
    """Run the command."""
    argparse.ArgumentParser(
        prog="interfaces", description="Print the interfaces of the running machine as Markdown."
    ).parse_args()

    def use(node: InterruptibleNode) -> int:
        settle(node)
        print(tables(node), end="")
        return DONE

    return talk(lambda: InterruptibleNode("interfaces"), use, "interfaces")


if __name__ == "__main__":
    sys.exit(main())
