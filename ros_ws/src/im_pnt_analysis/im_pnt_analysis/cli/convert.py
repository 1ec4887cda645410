"""``pnt convert``: YAML to PNML and back."""

import argparse
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from im_core.errors import ImError
from im_pnt.model.expand import INPUT_SEMAPHORE, OUTPUT_SEMAPHORE
from im_pnt.model.net import Net
from im_pnt.netfile import load_net, parse_net, yaml_text
from im_pnt.netfile.schema.names import as_name, is_qualified
from im_pnt.pnml import pnml_text
from im_pnt_analysis.cli.terminal import OK, write_output

_PNML_SUFFIXES = (".pnml", ".xml")
_YAML_SUFFIXES = (".yaml", ".yml")
_DESCRIPTION = """Writes a net file in the other format: YAML (.yaml, .yml) or PNML (.pnml, .xml).

PNML from here is valid by the grammar of ISO/IEC 15909-2. What that cannot say (tape symbols, guards, actions,
inhibitor arcs, capacities, times, services) is kept in 'toolspecific' elements: pnt reads it back without loss, other
tools do not see it, and it is named here.

Names of a PNML file that YAML cannot have are changed, and said; a net that no YAML file may hold (a transition that
nothing holds back) is refused. Comments, includes and templates are not kept."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    parser.set_defaults(run=run)
    parser.add_argument("file", metavar="IN", help="net file; FILE.pnml#NET for one net of several")
    parser.add_argument("output", metavar="OUT", help="file to write, .yaml, .yml, .pnml or .xml")
    parser.add_argument("--force", action="store_true", help="overwrite OUT if it is there")


def run(options: argparse.Namespace) -> int:
    """Convert a net file."""
    output = Path(options.output)
    suffix = output.suffix.lower()
    if suffix not in (*_YAML_SUFFIXES, *_PNML_SUFFIXES):
        raise ImError(f"cannot convert to '{output}': the name must end in .yaml, .yml, .pnml or .xml", code="input")
    net = load_net(options.file)
    if suffix in _YAML_SUFFIXES:
        net, notes = _with_our_names(net)
        text = yaml_text(net)
        parse_net(text, str(output))
    else:
        text, notes = pnml_text(net), tuple(_unseen(net))
    write_output(output, text, overwrite=options.force)
    for note in notes:
        print(f"pnt: {note}", file=sys.stderr)
    print(f"{output}: net {net.name}, {len(net.places)} places, {len(net.transitions)} transitions")
    return OK


def _unseen(net: Net) -> Iterator[str]:
    """Return the parts of a net invisible to other tools, a line each."""
    transitions = net.transitions.values()
    kept = {
        "inhibitor arcs of transitions": [t.name for t in transitions if t.inhibitors],
        "reset arcs of transitions": [t.name for t in transitions if t.resets],
        "capacities of places": [place.name for place in net.places.values() if place.capacity is not None],
        "tape symbols of transitions": [t.name for t in transitions if t.symbol],
        "guards of transitions": [t.name for t in transitions if t.guard],
        "values that transitions return or store": [t.name for t in transitions if t.result or t.store],
        "failures of actions of transitions": [t.name for t in transitions if t.action],
        "delays of transitions": [t.name for t in transitions if t.delay],
        "servers of transitions": [t.name for t in transitions if t.servers],
        "priorities of transitions": [t.name for t in transitions if t.priority],
        "services": list(net.services),
        "arguments of commands": list(net.commands),
    }
    for what, names in kept.items():
        if names:
            shown = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
            yield f"only pnt will see {what}: {shown}"


def _with_our_names(net: Net) -> tuple[Net, tuple[str, ...]]:
    """Rename a net to names of YAML nets; only nets of other tools have others, and no actions."""
    places = _renamed(net.places, (INPUT_SEMAPHORE, OUTPUT_SEMAPHORE))
    transitions = _renamed(net.transitions, ())
    changed = [(old, new) for names in (places, transitions) for old, new in names.items() if old != new]
    if not changed:
        return net, ()

    def arcs(old: Mapping[str, int]) -> dict[str, int]:
        return {places[name]: weight for name, weight in old.items()}

    renamed = replace(
        net,
        places={places[name]: replace(place, name=places[name]) for name, place in net.places.items()},
        transitions={
            transitions[t.name]: replace(
                t,
                name=transitions[t.name],
                inputs=arcs(t.inputs),
                outputs=arcs(t.outputs),
                inhibitors=arcs(t.inhibitors),
                resets=tuple(places[name] for name in t.resets),
            )
            for t in net.transitions.values()
        },
        rest=None if net.rest is None else tuple(places[name] for name in net.rest),
    )
    return renamed, tuple(f"'{old}' is named {new}" for old, new in changed)


def _renamed(names: Mapping[str, object], reserved: tuple[str, ...]) -> dict[str, str]:
    """Map each name to an allowed and free one."""
    taken = {name for name in names if is_qualified(name) and name not in reserved} | set(reserved)
    result: dict[str, str] = {}
    for name in names:
        new = name
        if not is_qualified(name) or name in reserved:
            base, number = as_name(name), 1
            new = base
            while new in taken:
                number += 1
                new = f"{base}_{number}"
            taken.add(new)
        result[name] = new
    return result
