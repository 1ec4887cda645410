"""Places, transitions and arcs of a PNML net: pages opened, references followed, labels read."""

from collections.abc import Iterator
from dataclasses import dataclass, field

from im_core.errors import nearest
from im_core.yamltext import Value
from im_pnt.model.net import LARGEST
from im_pnt.pnml.element import Element, check_children, label_integer, label_text
from im_pnt.pnml.extras import REMOTE, read_extras

_LONGEST_ID = 1000
_PASSED_OVER = frozenset({"name", "graphics", "toolspecific", "label", "labels", "description", "tagged"})
_TIMES = frozenset({"timed", "rate", "priority", "infiniteServer", "orientation"})
_ARCS = frozenset({"arc", "inputArc", "outputArc", "inhibitorArc"})
_NODES = frozenset({"place", "transition", "referencePlace", "referenceTransition"})
_PAGE = _PASSED_OVER | _NODES | _ARCS | {"page", "token", "tokenclass"}
_PLACE = _PASSED_OVER | {"initialMarking", "capacity"}
_TRANSITION = _PASSED_OVER | _TIMES
_ARC = _PASSED_OVER | {"inscription", "type", "arcpath"}
_FLOW = frozenset({"", "normal", "arc", "regular", "timed"})
_INHIBITOR = frozenset({"inhibitor", "tapnInhibitor", "inhibitorArc"})
_TEST = frozenset({"test", "read"})


@dataclass(slots=True)
class PlaceElement:
    """Place: name, tokens, blocking capacity (0: none), and own keys."""

    element: Element
    name: str
    tokens: int
    capacity: int
    extras: dict[str, tuple[Element, Value]]


@dataclass(slots=True)
class TransitionElement:
    """Transition with the arcs, by place names."""

    element: Element
    name: str
    extras: dict[str, tuple[Element, Value]]
    inputs: dict[str, int] = field(default_factory=dict)
    outputs: dict[str, int] = field(default_factory=dict)
    inhibitors: dict[str, int] = field(default_factory=dict)


@dataclass(slots=True)
class PnmlGraph:
    """Places and transitions by id."""

    places: dict[str, PlaceElement] = field(default_factory=dict)
    transitions: dict[str, TransitionElement] = field(default_factory=dict)
    remote: dict[str, str] = field(default_factory=dict)


def read_graph(net: Element, namespace: str, *, ours: bool) -> PnmlGraph:
    """Read the parts of a net.

    Args:
        net: The net.
        namespace: Namespace of the file.
        ours: Whether we wrote the file: names of places and transitions are then their names, otherwise their ids.

    Raises:
        NetFileError: An id twice or missing, an arc or reference that leads nowhere, or what is not understood.
    """
    by_id: dict[str, Element] = {}
    arcs: list[Element] = []
    for element in _objects(net, namespace):
        if element.tag in _ARCS:
            arcs.append(element)
            continue
        identity = element.attributes.get("id", "")
        if not 0 < len(identity) <= _LONGEST_ID:
            raise element.error(f"needs an 'id' of 1 to {_LONGEST_ID} characters")
        if identity in by_id:
            raise element.error(f"the id is there twice; the first is in line {by_id[identity].place.line}")
        by_id[identity] = element
    graph = PnmlGraph()
    for identity, element in by_id.items():
        _node(graph, identity, element, namespace, ours=ours)
    for arc in arcs:
        check_children(arc, namespace, _ARC)
        _arc(graph, arc, _end(by_id, arc, "source"), _end(by_id, arc, "target"))
    limited = [place for place in graph.places.values() if place.capacity]
    for transition in graph.transitions.values():
        _block(transition, limited)
    return graph


def _objects(net: Element, namespace: str) -> Iterator[Element]:
    """Return nodes and arcs of all pages, in the order of the file."""
    waiting = [net]
    while waiting:
        element = waiting.pop()
        if element.tag in ("net", "page"):
            check_children(element, namespace, _PAGE)
            waiting.extend(reversed(list(element.all("page", *_NODES, *_ARCS))))
        else:
            yield element


def _node(graph: PnmlGraph, identity: str, element: Element, namespace: str, *, ours: bool) -> None:
    name = label_text(element, "name") or identity if ours else identity
    if element.tag == "place":
        check_children(element, namespace, _PLACE)
        extras = read_extras(element)
        if REMOTE in extras:
            entry, value = extras[REMOTE]
            if not value.text or value.is_null:
                raise entry.error(f"{value.shown()} is not the name of a place of another net")
            graph.remote[identity] = value.text
            return
        tokens, capacity = label_integer(element, "initialMarking", 0, 0), label_integer(element, "capacity", 0, 0)
        graph.places[identity] = PlaceElement(element, name, tokens, capacity, extras)
    elif element.tag == "transition":
        check_children(element, namespace, _TRANSITION)
        graph.transitions[identity] = TransitionElement(element, name, read_extras(element))


def _end(by_id: dict[str, Element], arc: Element, attribute: str) -> str:
    """The id of the node at one end of an arc, references followed."""
    identity = arc.attributes.get(attribute)
    if identity is None:
        raise arc.error(f"'{attribute}' is missing")
    seen: list[str] = []
    at = arc
    while True:
        if identity not in by_id:
            raise at.error(f"there is no place or transition '{identity[:60]}'{nearest(identity, by_id)}")
        at = by_id[identity]
        if not at.tag.startswith("reference"):
            return identity
        if identity in seen:
            raise at.error(f"references go round: {' -> '.join([*seen, identity])}")
        seen.append(identity)
        identity = at.attributes.get("ref")
        if identity is None:
            raise at.error("'ref' is missing")


def _arc(graph: PnmlGraph, arc: Element, source: str, target: str) -> None:
    weight = label_integer(arc, "weight", 1, 1) if "weight" in arc.attributes else _inscription(arc)
    kind = _kind(arc)
    if source in graph.transitions and (target in graph.places or target in graph.remote):
        if kind not in _FLOW:
            raise arc.error(f"type '{kind}' leads from a place to a transition, not from '{source}' to '{target}'")
        outputs = graph.transitions[source].outputs
        name = graph.remote.get(target) or graph.places[target].name
        outputs[name] = outputs.get(name, 0) + weight
    elif source in graph.places and target in graph.transitions:
        transition, name = graph.transitions[target], graph.places[source].name
        if kind in _INHIBITOR:
            transition.inhibitors[name] = min(weight, transition.inhibitors.get(name, weight))
            return
        transition.inputs[name] = transition.inputs.get(name, 0) + weight
        if kind in _TEST:
            transition.outputs[name] = transition.outputs.get(name, 0) + weight
    elif source in graph.remote:
        raise arc.error(f"takes a token from '{graph.remote[source]}', a place of another net")
    else:
        raise arc.error(f"joins '{source}' and '{target}'; an arc joins a place and a transition")


def _kind(arc: Element) -> str:
    kind = arc.attributes.get("type") or label_text(arc, "type") or ""
    if arc.tag == "inhibitorArc":
        kind = "inhibitor"
    if kind not in _FLOW | _INHIBITOR | _TEST:
        raise arc.error(f"type '{kind[:60]}' is not understood; allowed are normal, inhibitor and test")
    return kind


def _inscription(arc: Element) -> int:
    text = label_text(arc, "inscription") or ""
    if "".join(text.split()) in ("[0,inf)", "[0,inf]"):
        return 1
    if text.startswith(("[", "(")):
        raise arc.error(f"inscription '{text[:60]}' is a time interval; nets without time are read")
    return label_integer(arc, "inscription", 1, 1)


def _block(transition: TransitionElement, limited: list[PlaceElement]) -> None:
    """Add inhibitor arcs for a blocking capacity of a place."""
    for place in limited:
        gain = transition.outputs.get(place.name, 0) - transition.inputs.get(place.name, 0)
        full = place.capacity - gain + 1
        if gain <= 0:
            continue
        if full < 1:
            raise transition.element.error(f"brings {gain} tokens to place {place.name}, whose capacity is less")
        transition.inhibitors[place.name] = min(full, transition.inhibitors.get(place.name, LARGEST))
