"""``im dom``: view and change data objects of the running machine."""

import argparse
import json
import sys
from collections.abc import Callable
from typing import Any

from im_bringup.ros.client_output import DONE
from im_bringup.ros.interruptible import InterruptibleNode, talk
from im_core.ros import qos
from im_core.ros.messages.status import status_to_error
from im_msgs.msg import ObjectInfo
from im_msgs.srv import AppendObject, GetObject, InvalidateObject, ListObjects, PutObject

#: Longest wait for /dom to be found, and for an answer [s].
TIMEOUT_S = 60.0
_SOURCE = "im dom"


class DomCommand(InterruptibleNode):
    """Asks ``/dom`` once."""

    def __init__(self) -> None:
        super().__init__("im_dom")

    def ask_dom(self, kind: Any, service: str, request: object) -> Any:
        """The answer of a service of ``/dom``.

        Raises:
            ImError: What was asked for is refused.
            KeyboardInterrupt: :meth:`interrupt` was called.
            WaitTimeoutError: ``/dom`` does not answer.
        """
        answer = self.ask(self.create_client(kind, service, qos_profile=qos.QUEUED_SERVICE), request, TIMEOUT_S)
        if not getattr(answer, "success", True):
            raise status_to_error(answer.status)
        return answer


def main() -> int:
    """Run the command."""
    options = _parser().parse_args()

    def do(node: DomCommand) -> int:
        options.do(node, options)
        return DONE

    return talk(DomCommand, do, "im dom")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="im dom",
        description="Show or change the data objects of the running machine. FIELDS are JSON.",
        epilog="Example: im dom append notes '{\"data\": [1.0, 2.0]}'. Exit codes: 0 done, 1 refused, 2 bad usage, "
        "3 the machine does not run, 130 interrupted.",
    )
    parts = parser.add_subparsers(required=True, metavar="WHAT")

    def part(name: str, do: Callable[[DomCommand, argparse.Namespace], None], about: str, *names: str) -> None:
        each = parts.add_parser(name, help=about, description=about)
        each.set_defaults(do=do)
        for argument in names:
            each.add_argument(argument, metavar=argument.upper())

    part("get", _get, "print the fields of an object as JSON", "name")
    part("put", _put, "store an object; fields that are not given keep their defaults", "name", "type", "fields")
    part("append", _append, "append to the sequences of an object", "name", "fields")
    part("invalidate", _invalidate, "declare an object invalid; a name that ends with / deletes all below it", "name")
    part("list", _list, "list the objects")
    return parser


def _list(node: DomCommand, _: argparse.Namespace) -> None:
    answer = node.ask_dom(ListObjects, "/dom/list", ListObjects.Request())
    for info in answer.objects:
        print(_line(info))
    if answer.status.message:
        print(f"im dom: {answer.status.message}", file=sys.stderr)


def _get(node: DomCommand, options: argparse.Namespace) -> None:
    answer = node.ask_dom(GetObject, "/dom/get", GetObject.Request(name=options.name, as_json=True))
    print(json.dumps(json.loads(answer.json), indent=2, ensure_ascii=False))


def _put(node: DomCommand, options: argparse.Namespace) -> None:
    request = PutObject.Request(name=options.name, type=options.type, json=options.fields, source=_SOURCE)
    print(_line(node.ask_dom(PutObject, "/dom/put", request).object))


def _append(node: DomCommand, options: argparse.Namespace) -> None:
    known = node.ask_dom(GetObject, "/dom/get", GetObject.Request(name=options.name, metadata_only=True)).object
    request = AppendObject.Request(name=options.name, type=known.type, json=options.fields, source=_SOURCE)
    print(_line(node.ask_dom(AppendObject, "/dom/append", request).object))


def _invalidate(node: DomCommand, options: argparse.Namespace) -> None:
    request = InvalidateObject.Request(name=options.name, source=_SOURCE)
    node.ask_dom(InvalidateObject, "/dom/invalidate", request)


def _line(info: ObjectInfo) -> str:
    state = "valid" if info.valid else "not valid"
    place = f" for {info.place}" if info.place else ""
    return f"{info.name} {info.type} version {info.version} {state}, {info.size} bytes, by {info.source}{place}"


if __name__ == "__main__":
    sys.exit(main())
