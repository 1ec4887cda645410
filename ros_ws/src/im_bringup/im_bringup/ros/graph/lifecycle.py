"""``im lifecycle``: states of the lifecycle nodes of the graph."""

import argparse
import sys

from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState

from im_bringup.ros.client_output import DONE
from im_bringup.ros.graph.client import GraphClient, GraphParser, absolute, print_all
from im_core.errors import ArgumentError, StateError

_STATE = "/get_state"
_TYPE = "lifecycle_msgs/srv/GetState"


def parser() -> GraphParser:
    """The arguments of the command."""
    found = GraphParser("lifecycle", "Show and change states of lifecycle nodes.", "im lifecycle get /mcs")
    found.verb("nodes", _nodes, "list the lifecycle nodes", waits=False)
    get = found.verb("get", _get, "print the state of a node, or of all of them")
    get.add_argument("node_name", nargs="?", type=absolute)
    found.verb("list", _list, "list the transitions that are possible now", "node_name")
    found.verb("set", _set, "order a transition", "node_name", "transition")
    return found


def _found(node: GraphClient) -> list[str]:
    services = node.listed("service")
    return [name.removesuffix(_STATE) for name, types in services.items() if name.endswith(_STATE) and _TYPE in types]


def _nodes(node: GraphClient, _: argparse.Namespace) -> int:
    return print_all(_found(node))


def _get(node: GraphClient, options: argparse.Namespace) -> int:
    for name in [options.node_name] if options.node_name else _found(node):
        state = node.ask(node.create_client(GetState, f"{name}{_STATE}"), GetState.Request(), options.timeout)
        prefix = "" if options.node_name else f"{name}: "
        print(f"{prefix}{state.current_state.label} [{state.current_state.id}]")
    return DONE


def _transitions(node: GraphClient, options: argparse.Namespace) -> dict[str, int]:
    """Return label and number of each transition of a node that is possible now."""
    client = node.create_client(GetAvailableTransitions, f"{options.node_name}/get_available_transitions")
    answer = node.ask(client, GetAvailableTransitions.Request(), options.timeout)
    return {each.transition.label: each.transition.id for each in answer.available_transitions}


def _list(node: GraphClient, options: argparse.Namespace) -> int:
    return print_all(f"- {label} [{number}]" for label, number in _transitions(node, options).items())


def _set(node: GraphClient, options: argparse.Namespace) -> int:
    known = _transitions(node, options)
    numbers = {str(number): number for number in known.values()} | known
    if options.transition not in numbers:
        there = f"{options.node_name} has no transition {options.transition} now"
        raise ArgumentError(f"{there}; it has {', '.join(known)}")
    request = ChangeState.Request()
    request.transition.id = numbers[options.transition]
    client = node.create_client(ChangeState, f"{options.node_name}/change_state")
    if not node.ask(client, request, options.timeout).success:
        raise StateError(f"the transition {options.transition} of {options.node_name} failed")
    return print_all(["Transitioning successful"])


def main() -> int:
    """Run the command."""
    return parser().run()


if __name__ == "__main__":
    sys.exit(main())
