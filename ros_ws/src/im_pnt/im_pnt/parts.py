"""What a net is drawn with: its places and transitions, and references to places where an arc would lead too far.

A reference is a small copy of a place, with its name and tokens (a fusion place; Jensen, "Coloured Petri Nets", 1992).
It stands where an arc to a distant place, to a place that many transitions lead to, or to a semaphore would be long.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from im_pnt.expand import INPUT_SEMAPHORE, OUTPUT_SEMAPHORE, expand, input_place
from im_pnt.layers import Box, Edge, backward_edges, connected, depths
from im_pnt.net import FunctionAction, Net, Place, RequestAction, Role, Transition

RADIUS = 11.0
REFERENCE_RADIUS = 6.5
LINE = 12.0
_WIDE, _NARROW = 6.2, 5.1
_FAILURE_SPAN, _RETURN_SPAN, _JUNCTION, _LAYERS = 3, 6, 4, 18


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
    """

    name: str
    kind: str
    label: str
    notes: tuple[str, ...]
    tokens: int
    box: Box
    place: str = ""
    link: str = ""


@dataclass(frozen=True, slots=True)
class DrawnArc:
    """An arc of a drawing.

    ``kind`` is ``flow``, ``failure`` (dashed), ``either`` (taken on success and on failure) or ``inhibitor`` (ends in a
    circle).
    """

    source: str
    target: str
    weight: int
    kind: str


def parts(net: Net, *, phases: bool = False) -> tuple[tuple[DrawnNode, ...], tuple[DrawnArc, ...]]:
    """Returns the nodes and arcs to draw.

    Args:
        net: The net as written; its coordination structures are drawn with it.
        phases: Draw start, active, end and failed of timed transitions; otherwise one box each.
    """
    whole = expand(net)
    shown = whole if phases else _folded(net, whole)
    nodes = {node.name: node for node in _nodes(shown)}
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
    """The arcs that end at a reference."""
    semaphores = {INPUT_SEMAPHORE, OUTPUT_SEMAPHORE} & {name for name, place in net.places.items() if place.tokens}
    far = {(arc.source, arc.target) for arc in arcs if {arc.source, arc.target} & semaphores}
    rest = [arc for arc in arcs if (arc.source, arc.target) not in far]
    into: dict[str, int] = {}
    for arc in rest:
        into[arc.target] = into.get(arc.target, 0) + (arc.target in net.places)
    edges = [(arc.source, arc.target) for arc in rest]
    names = [*(name for name, place in net.places.items() if place.tokens), *net.transitions, *net.places]
    names = list(dict.fromkeys([*names, *(arc.target for arc in rest)]))
    top = [name for name, place in net.places.items() if place.tokens]
    depth = depths(names, edges, backward_edges(names, edges, top))
    for arc in rest:
        span = abs(depth[arc.source] - depth[arc.target])
        limit = _FAILURE_SPAN if arc.kind in ("failure", "either") else _RETURN_SPAN if arc.target in top else 1000
        if span > limit or into[arc.target] >= _JUNCTION:
            far.add((arc.source, arc.target))
    edges = [edge for edge in edges if edge not in far]
    while cut := _waist(net, names, edges, top):
        far.update(cut)
        edges = [edge for edge in edges if edge not in cut]
    return far


def _waist(net: Net, names: list[str], edges: list[Edge], top: list[str]) -> set[Edge]:
    """Where a drawing would be too tall: the arcs into the place at which it is best continued in another column."""
    best: set[Edge] = set()
    least = _height(names, edges, top) - 3
    if least + 3 < _LAYERS:
        return best
    for place in net.places:
        cut = {(a, b) for a, b in edges if b == place}
        rest = [edge for edge in edges if edge not in cut]
        part = next(part for part in connected(names, rest) if place in part)
        if cut and not any(a in part for a, _ in cut) and (height := _height(names, rest, top)) < least:
            best, least = cut, height
    return best


def _height(names: list[str], edges: list[Edge], top: list[str]) -> int:
    return max(depths(names, edges, backward_edges(names, edges, top)).values())


def _reference(name: str, node: DrawnNode) -> DrawnNode:
    box = Box(REFERENCE_RADIUS, REFERENCE_RADIUS + 4 + _NARROW * len(node.label), 2 * REFERENCE_RADIUS)
    return replace(node, name=name, kind="reference", notes=(), box=box)


def _folded(net: Net, whole: Net) -> Net:
    """The net as written, with the coordination structures of the expanded one."""
    structure = {
        name: t
        for name, t in whole.transitions.items()
        if t.role not in (Role.PLAIN, Role.START, Role.END, Role.FAILED)
    }
    hidden = {f"{name}.active" for name, t in net.transitions.items() if t.action is not None}
    places = {name: place for name, place in whole.places.items() if name not in hidden}
    return Net(net.name, places, {**net.transitions, **structure}, escalate=net.escalate)


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
    notes = (f"object {place.data_object}",) if place.data_object else ()
    return DrawnNode(place.name, "place", place.name, notes, place.tokens, _round_box(place.name, notes), place.name)


def _round_box(label: str, notes: tuple[str, ...]) -> Box:
    wide = max([_WIDE * len(label), *(_NARROW * len(note) for note in notes)])
    return Box(RADIUS, RADIUS + 5 + wide, 2 * RADIUS)


def _transition(transition: Transition) -> DrawnNode:
    label, action = transition.name, transition.action
    link = f"{action.net}.{input_place(action.service)}" if isinstance(action, RequestAction) else ""
    notes = tuple(_notes(transition))
    half = max([40.0, _WIDE * len(label), *(_NARROW * len(note) for note in notes)]) / 2 + 7
    box = Box(half, half, 22.0 + LINE * len(notes))
    return DrawnNode(label, "transition", label, notes, 0, box, link=link)


def _notes(transition: Transition) -> Iterator[str]:
    """What a transition waits for and does, a line each: ``?`` reads a tape, ``!`` writes one (Hoare's CSP)."""
    if transition.symbol:
        yield f"?{transition.symbol}"
    if transition.guard:
        yield f"[{transition.guard}]"
    action = transition.action
    if isinstance(action, RequestAction):
        yield f"→ {action.net}.{action.service}"
    elif isinstance(action, FunctionAction):
        yield f"{action.function}()"
    elif action is not None:
        yield action.name
    for symbol in transition.emit:
        yield f"!{symbol}"


def _arcs(net: Net) -> Iterator[DrawnArc]:
    for t in net.transitions.values():
        for place, weight in t.inputs.items():
            yield DrawnArc(place, t.name, weight, "flow")
        for place, weight in t.inhibitors.items():
            yield DrawnArc(place, t.name, weight, "inhibitor")
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
