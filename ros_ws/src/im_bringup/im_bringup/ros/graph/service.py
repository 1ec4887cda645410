"""``im service``: services of the graph, and calls of one."""

import argparse
import sys

from im_bringup.ros.client_output import DONE
from im_bringup.ros.graph.client import GraphClient, GraphParser, class_of, message_from, message_text, print_all


def parser() -> GraphParser:
    """The arguments of the command."""
    example = "im service call /dom/list im_msgs/srv/ListObjects"
    found = GraphParser("service", "Show the services of the ROS graph, call one.", example)
    found.list_verb()
    found.verb("type", _type, "print the type of a service", "service_name")
    call = found.verb("call", _call, "call a service, and print its answer as YAML", "service_name", "service_type")
    call.add_argument("values", nargs="?", default="{}", help="fields of the request as YAML, e.g. '{data: true}'")
    return found


def _type(node: GraphClient, options: argparse.Namespace) -> int:
    return print_all([node.find("service", options.service_name, options.timeout)])


def _call(node: GraphClient, options: argparse.Namespace) -> int:
    name, type_name = options.service_name, options.service_type
    kind = class_of(type_name)
    request = message_from(kind.Request(), options.values, type_name)
    node.require("service", name, type_name, options.timeout)
    answer = node.ask(node.create_client(kind, name), request, options.timeout)
    print(message_text(answer), end="")
    return DONE


def main() -> int:
    """Run the command."""
    return parser().run()


if __name__ == "__main__":
    sys.exit(main())
