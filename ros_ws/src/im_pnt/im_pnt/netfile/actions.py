"""Actions, times and strategies of transitions."""

import re
from collections.abc import Mapping

from im_pnt.action import Action, FunctionAction, GoalAction, RequestAction, ServiceAction, TopicAction
from im_pnt.delay import Delay
from im_pnt.errors import NetError, nearest
from im_pnt.net import Strategy
from im_pnt.netfile import keys
from im_pnt.netfile.names import checked, is_name
from im_pnt.netfile.node import Node

_TYPES = {
    "service": re.compile(r"[A-Za-z]\w*/srv/[A-Za-z]\w*", re.ASCII),
    "goal": re.compile(r"[A-Za-z]\w*/action/[A-Za-z]\w*", re.ASCII),
    "topic": re.compile(r"[A-Za-z]\w*/msg/[A-Za-z]\w*", re.ASCII),
}
_FORMS = {"service": "package/srv/Type", "goal": "package/action/Type", "topic": "package/msg/Type"}


def read_action(node: Node, entries: Mapping[str, Node]) -> Action | None:
    """Reads what a transition does.

    Args:
        node: The transition.
        entries: Its keys.

    Raises:
        NetFileError: Two actions, or one that is not complete.
    """
    given = [key for key in keys.ACTIONS if key in entries]
    if len(given) > 1:
        raise node.error(f"has {' and '.join(given)}; one action is allowed")
    if not given:
        return None
    kind = given[0]
    value = entries[kind]
    if kind == "action":
        return FunctionAction(checked(value))
    if kind == "request":
        return _request(value)
    parts = value.items(keys.CALL[kind])
    required(value, parts, "name", "type")
    type_name = parts["type"].text()
    if not _TYPES[kind].fullmatch(type_name):
        raise parts["type"].error(f"{parts['type'].shown()} is not of the form {_FORMS[kind]}")
    name, build = parts["name"].text(), _optional(parts, "build")
    if kind == "topic":
        return TopicAction(name, type_name, _fields(parts.get("message")), build)
    handle, task = _optional(parts, "handle"), _optional(parts, "task")
    if kind == "service":
        return ServiceAction(name, type_name, _fields(parts.get("request")), build, handle, task)
    return GoalAction(name, type_name, _fields(parts.get("goal")), build, handle, task)


def read_delay(node: Node) -> Delay:
    """Reads ``2.5``, ``{exponential: {rate: 2}}`` or another distribution.

    Raises:
        NetFileError: No such distribution, or parameters that it cannot have.
    """
    if not node.is_mapping:
        return Delay("constant", (node.number(0.0),))
    entries = node.items()
    if len(entries) != 1:
        raise node.error(f"names {len(entries)} distributions; one of {', '.join(keys.DELAY)} is allowed")
    ((kind, where),) = entries.items()
    if kind not in keys.DELAY:
        raise where.key_error(f"there is no distribution '{kind}'{nearest(kind, keys.DELAY)}")
    if not where.is_mapping:
        raise where.error(f"is not a mapping with {', '.join(keys.DELAY[kind])}")
    given = {name: value.number(float("-inf")) for name, value in where.items(keys.DELAY[kind]).items()}
    if kind == "exponential":
        if len(given) != 1:
            raise where.error("needs either rate [1/s] or mean [s]")
        ((name, value),) = given.items()
        if value <= 0.0 or not 0.0 < 1.0 / value < float("inf"):
            raise where.error(f"{name} {value:g} is not > 0, or too small")
        values: tuple[float, ...] = (value if name == "rate" else 1.0 / value,)
    else:
        for name in keys.DELAY[kind]:
            if name not in given:
                raise where.error(f"'{name}' is missing")
        values = tuple(given[name] for name in keys.DELAY[kind])
    try:
        return Delay(kind, values)
    except NetError as error:
        raise where.error(error.message) from error


def read_strategy(node: Node) -> Strategy:
    """Reads a learned probability of success; what is not given keeps its default.

    Raises:
        NetFileError: A count that is not positive, or a decay outside 0..1.
    """
    entries = node.items(keys.STRATEGY)
    start = Strategy()
    return Strategy(
        entries["successes"].number(0.0, above=True) if "successes" in entries else start.successes,
        entries["failures"].number(0.0, above=True) if "failures" in entries else start.failures,
        entries["decay"].number(0.0, above=True, highest=1.0) if "decay" in entries else start.decay,
    )


def required(node: Node, entries: Mapping[str, Node], *names: str) -> None:
    """Sees to it that keys are there.

    Raises:
        NetFileError: One is missing.
    """
    for name in names:
        if name not in entries:
            raise node.error(f"'{name}' is missing")


def _request(value: Node) -> RequestAction:
    parts = value.items(keys.CALL["request"]) if value.is_mapping else {"to": value}
    required(value, parts, "to")
    net, dot, service = parts["to"].text().partition(".")
    if not dot or not is_name(net) or not is_name(service):
        raise parts["to"].error(f"{parts['to'].shown()} is not of the form net.service")
    return RequestAction(net, service, _fields(parts.get("arguments")), _optional(parts, "build"))


def _optional(parts: Mapping[str, Node], key: str) -> str | None:
    return checked(parts[key]) if key in parts else None


def _fields(node: Node | None) -> dict[str, object]:
    return {} if node is None else {name: value.plain() for name, value in node.items().items()}
