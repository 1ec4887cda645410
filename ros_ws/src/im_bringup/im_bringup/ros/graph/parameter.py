"""``im param``: parameters of the nodes of the graph."""

import argparse
import sys

from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.parameter import get_parameter_value, parameter_value_to_python

from im_bringup.ros.client_output import DONE
from im_bringup.ros.graph.client import GraphClient, GraphParser, absolute, print_all
from im_bringup.ros.interfaces import LISTING
from im_core.errors import NotFoundError, StateError


def parser() -> GraphParser:
    """The arguments of the command."""
    found = GraphParser("param", "Show and set parameters of nodes.", "im param set /mcs controller_state_rate 20.0")
    names = found.verb("list", _list, "list the parameters of a node, or of all of them")
    names.add_argument("node_name", nargs="?", type=absolute)
    get = found.verb("get", _get, "print a parameter", "node_name", "parameter_name")
    get.add_argument("--hide-type", action="store_true", help="print the value alone")
    found.verb("set", _set, "set a parameter; the value is YAML", "node_name", "parameter_name", "value")
    return found


_SCALARS = ("Boolean", "Integer", "Double", "String")
#: Words before a value, by type.
_TOLD = (
    "",
    *(f"{kind} value is" for kind in _SCALARS),
    *(f"{kind} values are" for kind in ("Byte", *_SCALARS)),
)


def _names(node: GraphClient, owner: str, timeout_s: float) -> list[str]:
    client = node.create_client(ListParameters, f"{owner}{LISTING}")
    return sorted(node.ask(client, ListParameters.Request(), timeout_s).result.names)


def _list(node: GraphClient, options: argparse.Namespace) -> int:
    if options.node_name:
        return print_all(_names(node, options.node_name, options.timeout))
    for service in node.listed("service"):
        if service.endswith(LISTING):
            owner = service.removesuffix(LISTING)
            print(f"{owner}:")
            print_all(f"  {name}" for name in _names(node, owner, options.timeout))
    return DONE


def _get(node: GraphClient, options: argparse.Namespace) -> int:
    owner, name = options.node_name, options.parameter_name
    client = node.create_client(GetParameters, f"{owner}/get_parameters")
    (value,) = node.ask(client, GetParameters.Request(names=[name]), options.timeout).values or (None,)
    if value is None or value.type == 0:
        raise NotFoundError(kind=f"parameter of {owner}", name=name, known=_names(node, owner, options.timeout))
    found = parameter_value_to_python(value)
    return print_all([str(found) if options.hide_type else f"{_TOLD[value.type]}: {found}"])


def _set(node: GraphClient, options: argparse.Namespace) -> int:
    client = node.create_client(SetParameters, f"{options.node_name}/set_parameters")
    value = get_parameter_value(string_value=options.value)
    request = SetParameters.Request(parameters=[Parameter(name=options.parameter_name, value=value)])
    (result,) = node.ask(client, request, options.timeout).results
    if not result.successful:
        raise StateError(f"setting {options.parameter_name} of {options.node_name} failed: {result.reason}")
    return print_all(["Set parameter successful"])


def main() -> int:
    """Run the command."""
    return parser().run()


if __name__ == "__main__":
    sys.exit(main())
