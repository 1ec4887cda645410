"""Parts of a drawing: places and transitions, and references to places at the end of far arcs.

A reference is a small copy of a place, with its name and tokens (a fusion place; Jensen, "Coloured Petri Nets", 1992).
It stands where an arc to a distant place, to a place that many transitions lead to, or to a semaphore would be long.
"""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from im_pnt.model.action import FunctionAction, RequestAction, ValuesAction
from im_pnt.model.expand import (
    INPUT_SEMAPHORE,
    OUTPUT_SEMAPHORE,
    active_place,
    cancelling_place,
    doubt_place,
    expand,
    input_place,
    servers_place,
)
from im_pnt.model.net import LARGEST, Arcs, Net, Place, Role, Transition
from im_pnt_display.drawing.layout import Edge, NodeBox
from im_pnt_display.drawing.references import far_edges

RADIUS = 11.0
REFERENCE_RADIUS = 6.5
LINE = 12.0
_WIDE, _NARROW = 6.2, 5.1
_LONGEST_VALUE = 60
_CANCELLED = "cancelled"
"""Guard of what is done because somebody has cancelled."""
_STRUCTURE = (Role.ACCEPT, Role.FINISH, Role.FINISH_FAILED, Role.RETURN, Role.WITHDRAWN)


@dataclass(frozen=True, slots=True)
class DrawnNode:
    """A part of a drawing.

    Attributes:
        name: Name, unique in the drawing.
        kind: ``place``, ``transition``, ``remote`` (place of another net) or ``reference`` (copy of a place).
        label: Name to show.
        notes: Further lines: tapes, guard, action, data object.
        tokens: Tokens of the initial marking.
        box: Room it takes.
        place: Place whose tokens it shows; empty for transitions.
        link: The ``net.place`` of another net that it leads to.
        timed: Whether it is a transition that fires after a time of its own.
        subnet: Whether it stands for a subnet in use, with a double border.
    """

    name: str
    kind: str
    label: str
    notes: tuple[str, ...]
    tokens: int
    box: NodeBox
    place: str = ""
    link: str = ""
    timed: bool = False
    subnet: bool = False


@dataclass(frozen=True, slots=True)
class DrawnArc:
    """An arc of a drawing.

    ``kind`` is ``flow``, ``failure`` (dashed), ``either`` (taken on success and on failure), ``inhibitor`` (ends in a
    circle) or ``reset`` (empties the place; dashes and dots).
    """

    source: str
    target: str
    weight: int
    kind: str


def parts(
    net: Net, *, phases: bool = False, usual: bool = False, subnets: bool = False
) -> tuple[tuple[DrawnNode, ...], tuple[DrawnArc, ...]]:
    """Return the nodes and arcs to draw.

    Args:
        net: The net as written; its coordination structures are drawn with it.
        phases: Draw start, active, end and failed of timed transitions; otherwise one box each.
        usual: Leave out what tokens reach only after a failure or a cancellation.
        subnets: Draw the parts of subnets in use; otherwise one box each.
    """
    whole = expand(net)
    folded = whole if phases else _folded(net, whole)
    counts: dict[str, int] = {}
    taken = _usual(folded) if usual else folded
    shown, renamed = _distinct(taken if phases or subnets else _subnets_folded(taken, counts))
    nodes = {node.name: node for node in _nodes(shown)}
    for name, count in counts.items():
        nodes[name] = _subnet(nodes[name], count)
    for name, place in renamed.items():
        nodes[name] = replace(nodes[name], label=place, place=place)
    arcs: list[DrawnArc] = []
    far = _far(shown, list(_arcs(shown)))
    for arc in _arcs(shown):
        if (arc.source, arc.target) in far:
            end = arc.source if arc.source in shown.places else arc.target
            reference = _reference(f"{arc.source}>{arc.target}", nodes[end])
            nodes[reference.name] = reference
            into = end == arc.target
            arcs.append(replace(arc, target=reference.name) if into else replace(arc, source=reference.name))
        else:
            arcs.append(arc)
    return tuple(nodes.values()), tuple(arcs)


def _far(net: Net, arcs: list[DrawnArc]) -> set[Edge]:
    """Return the arcs ending at a reference: arcs of semaphores, and long ones."""
    marked = [name for name, place in net.places.items() if place.tokens]
    semaphores = {INPUT_SEMAPHORE, OUTPUT_SEMAPHORE} & set(marked)
    far = {(arc.source, arc.target) for arc in arcs if {arc.source, arc.target} & semaphores}
    rest = [arc for arc in arcs if (arc.source, arc.target) not in far]
    names = list(dict.fromkeys([*marked, *net.transitions, *net.places, *(arc.target for arc in rest)]))
    failures = {(arc.source, arc.target) for arc in rest if arc.kind in ("failure", "either")}
    return far | far_edges(names, [(arc.source, arc.target) for arc in rest], net.places, set(marked), failures)


def _distinct(net: Net) -> tuple[Net, dict[str, str]]:
    """Return the net with other names for places named like a transition, and the former names."""
    new: dict[str, str] = {}
    for name in net.places:
        new[name] = name
        while new[name] in net.transitions or (new[name] != name and new[name] in net.places):
            new[name] += "_"
    if all(name == other for name, other in new.items()):
        return net, {}

    def arcs(old: Arcs) -> dict[str, int]:
        return {new[name]: weight for name, weight in old.items()}

    places = {new[name]: replace(place, name=new[name]) for name, place in net.places.items()}
    transitions = {
        t.name: replace(
            t,
            inputs=arcs(t.inputs),
            outputs=arcs(t.outputs),
            inhibitors=arcs(t.inhibitors),
            resets=tuple(new[name] for name in t.resets),
            on_failure=arcs(t.on_failure),
            on_doubt=arcs(t.on_doubt),
        )
        for t in net.transitions.values()
    }
    escalate = None if net.escalate is None else new[net.escalate]
    changed = replace(net, places=places, transitions=transitions, escalate=escalate)
    return changed, {other: name for name, other in new.items() if other != name}


def _reference(name: str, node: DrawnNode) -> DrawnNode:
    box = NodeBox(REFERENCE_RADIUS, REFERENCE_RADIUS + 4 + _NARROW * len(node.label), 2 * REFERENCE_RADIUS)
    return replace(node, name=name, kind="reference", notes=(), box=box)


def _folded(net: Net, whole: Net) -> Net:
    """The net as written, with the coordination structures of the expanded one."""
    structure = {name: t for name, t in whole.transitions.items() if t.role in _STRUCTURE}
    phases = (active_place, cancelling_place, doubt_place, servers_place)
    hidden = {place(name) for name, t in net.transitions.items() if t.action is not None for place in phases}
    places = {name: place for name, place in whole.places.items() if name not in hidden}
    return Net(net.name, places, {**net.transitions, **structure}, escalate=net.escalate)


def _subnets_folded(net: Net, counts: dict[str, int]) -> Net:
    """Return the net with a transition for each use of a subnet or scopes, and count the transitions of each."""
    own = [t for t in net.transitions.values() if t.role not in _STRUCTURE]
    uses = {t.name.partition(".")[0]: list[Transition]() for t in own if "." in t.name}
    places = {
        name: place for name, place in net.places.items() if name.partition(".")[0] not in uses or "." not in name
    }

    def arcs(every: Iterable[Arcs]) -> dict[str, int]:
        return {name: weight for each in every for name, weight in each.items() if name in places}

    transitions: dict[str, Transition] = {}
    for t in net.transitions.values():
        use = t.name.partition(".")[0]
        if t.role in _STRUCTURE or use not in uses:
            transitions[t.name] = t
        else:
            uses[use].append(t)
            transitions.setdefault(use, Transition(use))
    for use, inside in uses.items():
        counts[use] = len(inside)
        given = arcs(t.outputs for t in inside)
        escalated = {net.escalate: 1} if net.escalate else {}
        failed = arcs({**(t.on_failure or (escalated if t.action else {})), **t.on_doubt} for t in inside)
        transitions[use] = replace(
            net.transitions.get(use, transitions[use]),
            inputs=arcs(t.inputs for t in inside),
            outputs=given,
            remote_outputs={remote: weight for t in inside for remote, weight in t.remote_outputs.items()},
            inhibitors=arcs(t.inhibitors for t in inside),
            emit=tuple(dict.fromkeys(symbol for t in inside for symbol in t.emit)),
            on_failure={place: weight for place, weight in failed.items() if place not in given},
        )
    return replace(net, places=places, transitions=transitions)


def _subnet(node: DrawnNode, count: int) -> DrawnNode:
    notes = (*node.notes, f"{count} transitions")
    half = max(node.box.left, _NARROW * len(notes[-1]) / 2 + 7) + 3
    return replace(node, notes=notes, box=NodeBox(half, half, node.box.height + LINE + 6), subnet=True)


def _usual(net: Net) -> Net:
    """Return the part of a net that tokens reach while no action fails and nothing is cancelled.

    Places that no transition marks are marked by other nets.
    """
    every = net.transitions.values()
    produced = {place for t in every for place in (*t.outputs, *t.on_failure, *t.on_doubt)}
    reached = {place.name for place in net.places.values() if place.tokens or place.name not in produced}
    kept: dict[str, Transition] = {}
    asked = [t for t in every if str(t.guard) != _CANCELLED]
    while new := [t for t in asked if t.name not in kept and reached.issuperset(t.inputs)]:
        for t in new:
            kept[t.name] = t
            reached.update(t.outputs)
    transitions = {
        t.name: replace(
            t,
            inhibitors={place: weight for place, weight in t.inhibitors.items() if place in reached},
            resets=tuple(place for place in t.resets if place in reached),
            on_failure={},
            on_doubt={},
        )
        for t in every
        if t.name in kept
    }
    return replace(
        net,
        places={name: place for name, place in net.places.items() if name in reached},
        transitions=transitions,
        escalate=None,
    )


def _nodes(net: Net) -> Iterator[DrawnNode]:
    for place in net.places.values():
        if place.tokens:
            yield _place(place)
    for transition in net.transitions.values():
        yield _transition(transition)
    for place in net.places.values():
        if not place.tokens:
            yield _place(place)
    for name in sorted({str(remote) for t in net.transitions.values() for remote in t.remote_outputs}):
        yield DrawnNode(name, "remote", name, (), 0, _round_box(name, ()), name, name)


def _place(place: Place) -> DrawnNode:
    said = (place.title, f"object {place.data_object}" if place.data_object else "")
    notes = tuple(note for note in said if note)
    return DrawnNode(place.name, "place", place.name, notes, place.tokens, _round_box(place.name, notes), place.name)


def _round_box(label: str, notes: tuple[str, ...]) -> NodeBox:
    wide = max([_WIDE * len(label), *(_NARROW * len(note) for note in notes)])
    return NodeBox(RADIUS, RADIUS + 5 + wide, 2 * RADIUS)


def _transition(transition: Transition) -> DrawnNode:
    label, action = transition.name, transition.action
    link = f"{action.net}.{input_place(action.service)}" if isinstance(action, RequestAction) else ""
    notes = tuple(_notes(transition))
    half = max([40.0, _WIDE * len(label), *(_NARROW * len(note) for note in notes)]) / 2 + 7
    box = NodeBox(half, half, 22.0 + LINE * len(notes))
    timed = transition.delay is not None and action is None and transition.role is Role.PLAIN
    return DrawnNode(label, "transition", label, notes, 0, box, link=link, timed=timed)


def _notes(transition: Transition) -> Iterator[str]:
    """Return inputs and outputs of a transition, a line each: ``?`` reads a tape, ``!`` writes one (Hoare's CSP)."""
    if transition.title:
        yield transition.title
    if transition.symbol:
        yield f"?{transition.symbol}"
    if transition.guard:
        yield f"[{transition.guard}]"
    action = transition.action
    if isinstance(action, RequestAction):
        yield f"→ {action.net}.{action.service}"
    elif isinstance(action, FunctionAction):
        yield f"{action.function}()"
    elif action is not None and not isinstance(action, ValuesAction):
        yield action.name
    for name, value in transition.result.items():
        yield f"{name} = {_shortened(value)}"
    for name, value in transition.store.items():
        yield f"{name} := {_shortened(value)}"
    if transition.delay is not None:
        delay = transition.delay
        time = f"{delay.values[0]:g} s" if delay.kind == "constant" else str(delay)
        yield f"after {time}" if action is None else f"takes {time}"
    if transition.servers is not None:
        yield "all at once" if transition.servers == LARGEST else f"{transition.servers} at once"
    for symbol in transition.emit:
        yield f"!{symbol}"


def _shortened(value: object) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 3] + "..."


def _arcs(net: Net) -> Iterator[DrawnArc]:
    for t in net.transitions.values():
        for place, weight in t.inputs.items():
            yield DrawnArc(place, t.name, weight, "flow")
        for place, weight in t.inhibitors.items():
            yield DrawnArc(place, t.name, weight, "inhibitor")
        for place in t.resets:
            yield DrawnArc(place, t.name, 1, "reset")
        failure = dict(t.on_failure or ({net.escalate: 1} if t.action is not None and net.escalate else {}))
        for place, weight in t.outputs.items():
            both = failure.get(place) == weight
            if both:
                del failure[place]
            yield DrawnArc(t.name, place, weight, "either" if both else "flow")
        for remote, weight in t.remote_outputs.items():
            yield DrawnArc(t.name, str(remote), weight, "flow")
        for place, weight in failure.items():
            yield DrawnArc(t.name, place, weight, "failure")
