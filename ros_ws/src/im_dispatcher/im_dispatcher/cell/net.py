"""The net ``cell``: a place for each resource, and a transition for each command, taking all the needs at once."""

from im_core.text.yamltext import write_yaml
from im_dispatcher.cell.needs import Needs, Variant
from im_pnt.model.net import Net
from im_pnt.netfile import parse_net
from im_pnt.netfile.writer import schema_data

NAME = "cell"


def turn_of(variant: str) -> str:
    """Return the name of the enabling function for the turn of a command."""
    return f"turn_of_{variant}"


def cell_net(needs: Needs) -> Net:
    """Return the net: a running command holds all the needs, and a waiting one holds nothing.

    A command is handed on to its own net, and what it took is given back when that has ended it, however it did.
    """
    places: dict[str, object] = {resource: {"tokens": 1, "resource": True} for resource in needs.resources}
    transitions: dict[str, object] = {}
    for variant in needs.variants.values():
        failed = f"{variant.name}_failed"
        places[failed] = None
        transitions[variant.name] = _begin(variant, failed)
        transitions[failed] = {"in": [failed], "out": list(variant.needs), "emit": f"{variant.symbol}_failed"}
    text = {
        "net": NAME,
        "description": "What commands take of the cell, all at once, and give back when they have ended.",
        "commands": {variant.symbol: _declared(variant) for variant in needs.variants.values()},
        "places": places,
        "transitions": transitions,
    }
    return parse_net(write_yaml(text))


def _declared(variant: Variant) -> dict[str, object]:
    return {"description": variant.declared.description, "arguments": schema_data(variant.declared.arguments)}


def _handed_on(variant: Variant) -> dict[str, object]:
    """Return the arguments of the command, with the deciding ones as values."""
    arguments = variant.declared.arguments.arguments
    return {name: variant.choice.get(name, f"${{arguments.{name}}}") for name in arguments}


def _begin(variant: Variant, failed: str) -> dict[str, object]:
    return {
        "symbol": variant.symbol,
        "in": list(variant.needs),
        "guard": turn_of(variant.name),
        "out": list(variant.needs),
        "request": {"to": f"{variant.net}.{variant.symbol}", "arguments": _handed_on(variant)},
        "emit": f"{variant.symbol}_done",
        "on_failure": [failed],
    }
