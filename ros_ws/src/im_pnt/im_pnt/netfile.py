"""Net files: YAML to :class:`~im_pnt.net.Net`, with complaints that name file, line and the nearest right name."""

import re
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

from im_pnt.errors import nearest
from im_pnt.expand import INPUT_SEMAPHORE, OUTPUT_SEMAPHORE
from im_pnt.net import (
    Action,
    FunctionAction,
    GoalAction,
    Guard,
    Net,
    Place,
    RemotePlace,
    RequestAction,
    Service,
    ServiceAction,
    Transition,
)
from im_pnt.yamlnode import YamlNode, read_file, read_yaml

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_TYPE = re.compile(r"[A-Za-z]\w*/(srv|action)/[A-Za-z]\w*")
_NET_KEYS = ("net", "description", "places", "services", "transitions", "escalate", "rest")
_PLACE_KEYS = ("tokens", "capacity", "data_object", "on_invalid", "remote")
_SERVICE_KEYS = ("entry", "done", "failed")
_ACTION_KEYS = ("action", "service", "goal", "request")
_TRANSITION_KEYS = (
    *("in", "out", "inhibitors", "guard", "symbol", "emit", "on_failure", "timeout", "priority"),
    *_ACTION_KEYS,
)


def load_net(path: str | Path) -> Net:
    """Reads a net file.

    Args:
        path: YAML file with one net.

    Returns:
        The net; its names are consistent, its behaviour is not verified.

    Raises:
        NetFileError: The file is not a net; names file, line and what is allowed.
    """
    return _net(read_file(Path(path)))


def parse_net(text: str, source: str = "net") -> Net:
    """Reads a net from text, as :func:`load_net` does from a file.

    Raises:
        NetFileError: The text is not a net.
    """
    return _net(read_yaml(text, source))


def _net(root: YamlNode) -> Net:
    keys = root.items(_NET_KEYS)
    for required in ("net", "places", "transitions"):
        if required not in keys:
            raise root.error(f"'{required}' is missing")
    name = _name(keys["net"])
    places = {key: _place(key, node) for key, node in keys["places"].items().items()}
    for key, node in keys["places"].items().items():
        for target in places[key].on_invalid:
            _known(node, target, places)
    services = _services(keys["services"], places) if "services" in keys else {}
    escalate = _known_place(keys["escalate"], places) if "escalate" in keys else None
    rest = None
    if "rest" in keys:
        rest = tuple(_known_place(element, places) for element in keys["rest"].elements())
    transitions = {
        key: _transition(key, node, name, places, escalate) for key, node in keys["transitions"].items().items()
    }
    if not transitions:
        raise keys["transitions"].error("the net has no transition")
    description = keys["description"].text() if "description" in keys else ""
    return Net(name, places, transitions, services, escalate, rest, description, root.file)


def _name(node: YamlNode, text: str | None = None) -> str:
    name = node.text() if text is None else text
    if not _NAME.fullmatch(name):
        raise node.error(f"'{name}' is not a name (letters, digits and _, not starting with a digit)")
    return name


def _known(node: YamlNode, name: str, places: Collection[str]) -> str:
    if name not in places:
        raise node.error(f"there is no place '{name}'{nearest(name, places)}")
    return name


def _known_place(node: YamlNode, places: Collection[str]) -> str:
    return _known(node, node.text(), places)


def _place(name: str, node: YamlNode) -> Place:
    _name(node, name)
    if name in (INPUT_SEMAPHORE, OUTPUT_SEMAPHORE):
        raise node.error(f"the name '{name}' belongs to the coordination structure")
    if node.is_null:
        return Place(name)
    if not node.is_mapping:
        return Place(name, tokens=node.integer(0))
    keys = node.items(_PLACE_KEYS)
    tokens = keys["tokens"].integer(0) if "tokens" in keys else 0
    capacity = keys["capacity"].integer(1) if "capacity" in keys else None
    if capacity is not None and tokens > capacity:
        raise node.error(f"{tokens} tokens are more than the capacity of {capacity}")
    data_object = keys["data_object"].text() if "data_object" in keys else None
    on_invalid: tuple[str, ...] = ()
    if "on_invalid" in keys:
        if data_object is None:
            raise keys["on_invalid"].error("needs a data_object whose loss of validity it answers")
        on_invalid = tuple(element.text() for element in keys["on_invalid"].elements())
    remote = keys["remote"].boolean() if "remote" in keys else False
    return Place(name, tokens, capacity, data_object, on_invalid, remote)


def _services(node: YamlNode, places: Collection[str]) -> dict[str, Service]:
    services: dict[str, Service] = {}
    for name, entry in node.items().items():
        _name(entry, name)
        keys = entry.items(_SERVICE_KEYS)
        for required in _SERVICE_KEYS:
            if required not in keys:
                raise entry.error(f"'{required}' is missing")
        ends = {key: _known_place(keys[key], places) for key in _SERVICE_KEYS}
        if len(set(ends.values())) < len(ends):
            raise entry.error("entry, done and failed must be three different places")
        services[name] = Service(name, **ends)
    return services


def _arcs(node: YamlNode, places: Collection[str]) -> tuple[dict[str, int], dict[RemotePlace, int]]:
    """Reads ``a``, ``[a, b]`` or ``{a: 2}``; names with a dot are places of other nets."""
    pairs: Iterable[tuple[str, YamlNode, int]]
    if node.is_mapping:
        pairs = [(name, value, value.integer(1)) for name, value in node.items().items()]
    else:
        pairs = [(element.text(), element, 1) for element in node.elements()]
    local: dict[str, int] = {}
    remote: dict[RemotePlace, int] = {}
    for name, where, weight in pairs:
        net, dot, place = name.partition(".")
        if dot:
            target = RemotePlace(_name(where, net), _name(where, place))
            remote[target] = remote.get(target, 0) + weight
        else:
            _known(where, name, places)
            local[name] = local.get(name, 0) + weight
    return local, remote


def _local_arcs(keys: Mapping[str, YamlNode], key: str, places: Collection[str]) -> dict[str, int]:
    if key not in keys:
        return {}
    local, remote = _arcs(keys[key], places)
    for target in remote:
        raise keys[key].error(f"'{target}' is a place of another net; only 'out' may name one")
    return local


def _guard(node: YamlNode) -> Guard:
    text = node.text().strip()
    negated = text.startswith("not ")
    return Guard(_name(node, text.removeprefix("not ").strip()), negated)


def _transition(name: str, node: YamlNode, net: str, places: Collection[str], escalate: str | None) -> Transition:
    _name(node, name)
    keys = node.items(_TRANSITION_KEYS)
    inputs = _local_arcs(keys, "in", places)
    outputs, remote_outputs = _arcs(keys["out"], places) if "out" in keys else ({}, {})
    on_failure = _local_arcs(keys, "on_failure", places)
    inhibitors = _local_arcs(keys, "inhibitors", places)
    for target in remote_outputs:
        if target.net == net:
            raise keys["out"].error(f"'{target}' is a place of this very net; write '{target.place}'")
    symbol = _name(keys["symbol"]) if "symbol" in keys else None
    action = _action(node, keys)
    if action is None:
        for key in ("on_failure", "timeout"):
            if key in keys:
                raise keys[key].error(f"needs an action that can fail ({', '.join(_ACTION_KEYS)})")
    elif not on_failure and escalate is None:
        raise node.error(f"{action} can fail: say where the tokens go with 'on_failure', or give the net 'escalate'")
    if not inputs and symbol is None:
        raise node.error("has neither input places nor a symbol, and would fire without end")
    for place in inputs.keys() & inhibitors.keys():
        if inhibitors[place] <= inputs[place]:
            raise keys["inhibitors"].error(f"'{place}' both enables and disables it; it could never fire")
    return Transition(
        name,
        inputs,
        outputs,
        remote_outputs,
        inhibitors,
        _guard(keys["guard"]) if "guard" in keys else None,
        symbol,
        tuple(_name(element) for element in keys["emit"].elements()) if "emit" in keys else (),
        action,
        on_failure,
        keys["timeout"].positive() if "timeout" in keys else None,
        keys["priority"].integer(-1_000_000) if "priority" in keys else 0,
        origin=name,
        line=node.line,
    )


def _action(node: YamlNode, keys: Mapping[str, YamlNode]) -> Action | None:
    given = [key for key in _ACTION_KEYS if key in keys]
    if len(given) > 1:
        raise node.error(f"has {' and '.join(given)}; one action is allowed")
    if not given:
        return None
    kind = given[0]
    value = keys[kind]
    if kind == "action":
        return FunctionAction(_name(value))
    if kind == "request":
        return _request(value)
    parts = value.items(("name", "type", "request" if kind == "service" else "goal", "build", "handle", "task"))
    for required in ("name", "type"):
        if required not in parts:
            raise value.error(f"'{required}' is missing")
    type_name = parts["type"].text()
    match = _TYPE.fullmatch(type_name)
    if not match or match.group(1) != ("srv" if kind == "service" else "action"):
        wanted = "package/srv/Type" if kind == "service" else "package/action/Type"
        raise parts["type"].error(f"'{type_name}' is not of the form {wanted}")
    make = ServiceAction if kind == "service" else GoalAction
    return make(
        parts["name"].text(),
        type_name,
        _fields(parts.get("request") or parts.get("goal")),
        _name(parts["build"]) if "build" in parts else None,
        _name(parts["handle"]) if "handle" in parts else None,
        _name(parts["task"]) if "task" in parts else None,
    )


def _request(value: YamlNode) -> RequestAction:
    parts = value.items(("to", "arguments", "build")) if value.is_mapping else {"to": value}
    if "to" not in parts:
        raise value.error("'to' is missing")
    net, dot, service = parts["to"].text().partition(".")
    if not dot:
        raise parts["to"].error(f"'{net}' is not of the form net.service")
    return RequestAction(
        _name(parts["to"], net),
        _name(parts["to"], service),
        _fields(parts.get("arguments")),
        _name(parts["build"]) if "build" in parts else None,
    )


def _fields(node: YamlNode | None) -> dict[str, object]:
    return {} if node is None else {name: value.plain() for name, value in node.items().items()}
