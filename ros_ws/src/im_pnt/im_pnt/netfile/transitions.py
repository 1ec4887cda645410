"""Transitions of net files."""

from collections.abc import Collection, Iterable, Mapping

from im_pnt.net import Guard, RemotePlace, Transition
from im_pnt.netfile import keys
from im_pnt.netfile.actions import read_action, read_delay, read_strategy
from im_pnt.netfile.names import checked, is_name, no_place
from im_pnt.netfile.node import LARGEST, Node

_NEEDS_ACTION = ("on_failure", "on_doubt", "timeout", "success", "strategy")


def read_transition(
    name: str, node: Node, *, net: str, places: Collection[str], escalate: str | None, foreign: bool
) -> Transition:
    """Reads a transition.

    Args:
        name: Its name.
        node: What is written about it.
        net: Name of its net.
        places: Places of its net.
        escalate: Place for failures without ``on_failure``.
        foreign: Whether the net comes from another tool, which may mean what an author of ours cannot.

    Raises:
        NetFileError: It is wrong in itself.
    """
    entries = node.items(keys.TRANSITION)
    inputs = _local_arcs(entries, "in", places)
    outputs, remote_outputs = _arcs(entries["out"], places) if "out" in entries else ({}, {})
    on_failure = _local_arcs(entries, "on_failure", places)
    inhibitors = _local_arcs(entries, "inhibitors", places)
    for target in remote_outputs:
        if target.net == net:
            raise entries["out"].error(f"'{target}' is a place of this very net; write '{target.place}'")
    symbol = checked(entries["symbol"]) if "symbol" in entries else None
    action = read_action(node, entries)
    if action is None:
        for key in _NEEDS_ACTION:
            if key in entries:
                raise entries[key].key_error(f"needs an action that can fail ({', '.join(keys.ACTIONS)})")
    elif not on_failure and escalate is None:
        raise node.error(f"{action} can fail: say where the tokens go with 'on_failure', or give the net 'escalate'")
    if not foreign:
        if not inputs and symbol is None:
            raise node.error("has neither input places nor a symbol, and would fire without end")
        for place in inputs.keys() & inhibitors.keys():
            if inhibitors[place] <= inputs[place]:
                raise entries["inhibitors"].error(f"'{place}' both enables and disables it; it could never fire")
    return Transition(
        name,
        inputs,
        outputs,
        remote_outputs,
        inhibitors,
        _guard(entries["guard"]) if "guard" in entries else None,
        symbol,
        tuple(checked(element) for element in entries["emit"].elements()) if "emit" in entries else (),
        action,
        on_failure,
        _local_arcs(entries, "on_doubt", places),
        timeout=entries["timeout"].number(0.0, above=True) if "timeout" in entries else None,
        delay=read_delay(entries["delay"]) if "delay" in entries else None,
        success=entries["success"].number(0.0, highest=1.0) if "success" in entries else 1.0,
        weight=entries["weight"].number(0.0, above=True) if "weight" in entries else 1.0,
        strategy=read_strategy(entries["strategy"]) if "strategy" in entries else None,
        priority=entries["priority"].integer(-LARGEST) if "priority" in entries else 0,
        origin=name,
        line=node.line,
    )


def _arcs(node: Node, places: Collection[str]) -> tuple[dict[str, int], dict[RemotePlace, int]]:
    """Reads ``a``, ``[a, b]`` or ``{a: 2}``; names with a dot that are no place here are places of other nets."""
    arcs: Iterable[tuple[str, Node, int]]
    if node.is_mapping:
        arcs = [(name, value, value.integer(1)) for name, value in node.items().items()]
    else:
        arcs = [(element.text(), element, 1) for element in node.elements()]
    local: dict[str, int] = {}
    remote: dict[RemotePlace, int] = {}
    for name, where, weight in arcs:
        net, dot, place = name.partition(".")
        if name in places:
            local[name] = local.get(name, 0) + weight
        elif dot and is_name(net) and is_name(place):
            target = RemotePlace(net, place)
            remote[target] = remote.get(target, 0) + weight
        elif where.key is not None and node.is_mapping:
            raise where.key_error(no_place(name, places))
        else:
            raise where.error(no_place(name, places))
    return local, remote


def _local_arcs(entries: Mapping[str, Node], key: str, places: Collection[str]) -> dict[str, int]:
    if key not in entries:
        return {}
    local, remote = _arcs(entries[key], places)
    for target in remote:
        raise entries[key].error(f"'{target}' is a place of another net; only 'out' may name one")
    return local


def _guard(node: Node) -> Guard:
    text = node.text().strip()
    negated = text.startswith("not ")
    name = text.removeprefix("not ").strip()
    if not is_name(name):
        raise node.error(f"{node.shown()} is not a name, nor 'not' and a name")
    return Guard(name, negated)
