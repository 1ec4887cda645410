"""Client of the ROS graph: waits for names, types and answers; common options and exit codes."""

import argparse
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any

from rclpy.action import get_action_names_and_types
from rclpy.node import Node

from im_bringup.ros.client_output import DONE, FAILED, INTERRUPTED, NOT_RUNNING, USAGE
from im_bringup.ros.interfaces import settle
from im_bringup.ros.interruptible import InterruptibleNode, spun
from im_core.errors import ArgumentError, ImError, NotFoundError, StateError, StoreError, WaitTimeoutError
from im_core.files import write_whole
from im_core.names import run_dir
from im_core.options import NumberParser, seconds
from im_core.output import complain
from im_core.ros.messages.interfaces import interface_class
from im_core.ros.messages.message_fields import fields_of, filled
from im_core.text.yamltext import YamlError, as_data, read_yaml, write_yaml

#: Longest wait for a name, a message or an answer, where no other is given [s].
TIMEOUT_S = 10.0
#: A list is whole when nothing has come or gone for so long [s].
_SETTLED_S = 1.0
NamesAndTypes = Sequence[tuple[str, Sequence[str]]]
#: Functions that list the names of the graph, with the types of each.
NAMES: dict[str, Callable[[Node], NamesAndTypes]] = {
    "topic": Node.get_topic_names_and_types,
    "service": Node.get_service_names_and_types,
    "action": get_action_names_and_types,
    "node": lambda node: [(f"{space.rstrip('/')}/{name}", ()) for name, space in node.get_node_names_and_namespaces()],
}


class GraphClient(InterruptibleNode):
    """Hidden node waiting for names, types and answers."""

    def __init__(self) -> None:
        super().__init__("_im")

    def wait(self, ready: Callable[[], bool], what: str, timeout_s: float) -> None:
        """Wait until something is so; raises as :meth:`InterruptibleNode.ask`."""
        self._until(ready, what, timeout_s)

    def go_on(self) -> None:
        """Take back an interruption: the closing work is waited for."""
        self._interrupted.clear()

    def listed(self, kind: str) -> dict[str, Sequence[str]]:
        """Return the names of a kind once the graph has settled, without hidden ones, and the types of each."""
        settle(self, _SETTLED_S)
        return dict(sorted((name, types) for name, types in NAMES[kind](self) if "/_" not in name))

    def find(self, kind: str, name: str, timeout_s: float) -> str:
        """Wait for a name in the graph; return its type, empty for a node.

        Args:
            kind: What it is, of :data:`NAMES`.
            name: Its name, with its slash.
            timeout_s: Longest wait [s].

        Raises:
            KeyboardInterrupt: Somebody interrupted.
            NotFoundError: It is not there in time; names the nearest.
            StateError: It has several types.
        """
        with suppress(WaitTimeoutError):
            self.wait(lambda: name in dict(NAMES[kind](self)), f"the {kind} {name}", timeout_s)
        found = dict(NAMES[kind](self))
        if name not in found:
            shown = [each for each in found if "/_" not in each]
            raise NotFoundError(kind=kind, name=name, known=shown, waited_s=timeout_s)
        if len(found[name]) > 1:
            raise StateError(f"the {kind} {name} has several types: {', '.join(found[name])}")
        return "".join(found[name])

    def require(self, kind: str, name: str, type_name: str, timeout_s: float) -> None:
        """Wait for a name in the graph, and refuse another type; otherwise as :meth:`find`."""
        if (found := self.find(kind, name, timeout_s)) != type_name:
            raise ArgumentError(f"the {kind} {name} is of type {found}, not {type_name}")


Verb = Callable[[GraphClient, Any], int]
_GRAPH_NAMES = {"action_name", "node_name", "service_name", "topic_name"}


class GraphParser:
    """Arguments of a command on the graph: a verb, followed by arguments.

    Args:
        kind: The command, ``im <kind>``.
        description: Its help.
        example: A line of it.
    """

    def __init__(self, kind: str, description: str, example: str) -> None:
        self.kind = kind
        self._parser = NumberParser(
            prog=f"im {kind}",
            description=description,
            epilog=f"Example: {example} . Exit codes: 0 done, 1 failed or refused, 2 bad usage, 3 nobody was there in "
            "time, 130 interrupted.",
        )
        self._verbs = self._parser.add_subparsers(required=True, metavar="VERB")

    def verb(self, name: str, do: Verb, about: str, *arguments: str, waits: bool = True) -> argparse.ArgumentParser:
        """Add a verb, and return its parser.

        Args:
            name: Its name, as in ros2cli.
            do: Does it; returns the exit code.
            about: Its help.
            arguments: Names of its positional arguments.
            waits: Whether it has a longest wait.
        """
        parser: argparse.ArgumentParser = self._verbs.add_parser(name, help=about, description=about)
        parser.set_defaults(do=do)
        for argument in arguments:
            parser.add_argument(argument, type=absolute if argument in _GRAPH_NAMES else str)
        if waits:
            parser.add_argument(
                "--timeout",
                type=seconds,
                default=TIMEOUT_S,
                metavar="S",
                help="longest wait for the name, and for an answer [s] (default: %(default)g)",
            )
        return parser

    def list_verb(self) -> None:
        """Add the verb ``list`` of all names of the kind."""
        kind = self.kind
        parser = self.verb("list", lambda node, options: _list(node, kind, options), f"list the {kind}s", waits=False)
        parser.add_argument("-t", "--show-types", action="store_true", help="show the types, too")

    def run(self, texts: Sequence[str] | None = None) -> int:
        """Do the verb of a command line; return the exit code.

        Args:
            texts: The command line; None: that of the process.
        """
        options = self._parser.parse_args(texts)
        try:
            with spun(GraphClient) as node:
                if getattr(options, "node_name", None):
                    node.find("node", options.node_name, options.timeout)
                code: int = options.do(node, options)
                return code
        except KeyboardInterrupt:
            return INTERRUPTED
        except ImError as error:
            complain(f"im {self.kind}: {error.message}")
            if isinstance(error, ArgumentError):
                return USAGE
            return NOT_RUNNING if isinstance(error, WaitTimeoutError | NotFoundError) else FAILED


def absolute(name: str) -> str:
    """Return a name with the leading slash."""
    return name if name.startswith("/") else f"/{name}"


def class_of(type_name: str) -> Any:
    """Return the class of a type.

    Raises:
        ArgumentError: No such package or type is installed.
    """
    try:
        return interface_class(type_name)
    except NotFoundError as error:
        raise ArgumentError(error.message) from error


def message_from(message: Any, text: str, type_name: str) -> Any:
    """Fill a message with values in YAML, and return it.

    Raises:
        ArgumentError: It is no YAML, or a value does not fit.
    """
    try:
        return filled(message, as_data(read_yaml(text, "the values")), type_name)
    except YamlError as error:
        raise ArgumentError(f"the values: {error}") from error
    except ImError as error:
        raise ArgumentError(error.message) from error


def message_text(message: Any, longest: int | None = None) -> str:
    """Return a message as YAML.

    Args:
        message: The message.
        longest: Texts and lists are cut behind so many characters or elements; None: they are whole.
    """
    return write_yaml(_cut(fields_of(message), longest))


def print_all(lines: Iterable[str]) -> int:
    """Print lines; return the exit code."""
    for line in lines:
        print(line, flush=True)
    return DONE


def _cut(value: Any, longest: int | None) -> Any:
    if isinstance(value, dict):
        return {name: _cut(each, longest) for name, each in value.items()}
    if longest is None or not isinstance(value, str | list):
        return [_cut(each, longest) for each in value] if isinstance(value, list) else value
    if isinstance(value, str):
        return value if len(value) <= longest else f"{value[:longest]}..."
    shown = [_cut(each, longest) for each in value[:longest]]
    return shown if len(value) <= longest else [*shown, "..."]


def _list(node: GraphClient, kind: str, options: argparse.Namespace) -> int:
    found = node.listed(kind)
    with suppress(StoreError):  # a shell then completes no names
        write_whole(run_dir() / f"{kind}s.txt", "".join(f"{name}\n" for name in found))
    return print_all(f"{name} [{', '.join(types)}]" if options.show_types else name for name, types in found.items())
