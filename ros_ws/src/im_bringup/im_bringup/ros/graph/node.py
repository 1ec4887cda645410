"""``im node``: nodes of the graph."""

import argparse
import sys
from collections.abc import Sequence

from rclpy.action.graph import get_action_client_names_and_types_by_node, get_action_server_names_and_types_by_node
from rclpy.node import Node

from im_bringup.ros.client_output import DONE
from im_bringup.ros.graph.client import GraphClient, GraphParser


def parser() -> GraphParser:
    """The arguments of the command."""
    found = GraphParser("node", "Show the nodes of the ROS graph.", "im node info /dispatcher")
    found.list_verb()
    found.verb("info", _info, "print topics, services and actions of a node", "node_name")
    return found


_ENDS = {
    "Subscribers": Node.get_subscriber_names_and_types_by_node,
    "Publishers": Node.get_publisher_names_and_types_by_node,
    "Service Servers": Node.get_service_names_and_types_by_node,
    "Service Clients": Node.get_client_names_and_types_by_node,
    "Action Servers": get_action_server_names_and_types_by_node,
    "Action Clients": get_action_client_names_and_types_by_node,
}


def _info(node: GraphClient, options: argparse.Namespace) -> int:
    node.listed("node")  # what it offers comes after its name
    print(options.node_name)
    space, _, name = options.node_name.rpartition("/")
    for title, find in _ENDS.items():
        ends: Sequence[tuple[str, Sequence[str]]] = find(node, name, space or "/")
        print(f"  {title}:")
        for end, types in sorted(ends):
            if "/_" not in end:
                print(f"    {end}: {', '.join(types)}")
    return DONE


def main() -> int:
    """Run the command."""
    return parser().run()


if __name__ == "__main__":
    sys.exit(main())
