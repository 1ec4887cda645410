"""Places, transitions and arcs of a PNML net: pages opened, references followed, labels read."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from im_core.errors import nearest, quoted_text, shortened
from im_core.text.yamltext import Value
from im_pnt.model.net import LARGEST
from im_pnt.pnml.check import ARCS, NODES, Known, check
from im_pnt.pnml.element import Element
from im_pnt.pnml.extras import REMOTE, read_extras
from im_pnt.pnml.label import Count, counted, find_label, interval_of, label_count, label_text
from im_pnt.pnml.timing import Timing, timing_of

_LONGEST_ID = 1000
_KINDS = {
    **dict.fromkeys(("normal", "arc", "regular", "timed", "transport", "inputArc", "outputArc"), "normal"),
    **dict.fromkeys(("inhibitor", "tapnInhibitor", "inhibitorArc"), "inhibitor"),
    **dict.fromkeys(("test", "read"), "test"),
}
_WRAPPERS = ("inhibitor", "test")
"""Of what SNAKES inscribes on arcs."""
_FINAL = Known(frozenset({"text"}), attributes=frozenset({"idref"}))


@dataclass(slots=True)
class PlaceElement:
    """Place: names, tokens, blocking capacity (0: none), and own keys."""

    element: Element
    name: str
    title: str
    tokens: int
    capacity: int
    extras: dict[str, tuple[Element, Value]]


@dataclass(slots=True)
class TransitionElement:
    """Transition with the arcs, by place names."""

    element: Element
    name: str
    title: str
    timing: Timing
    extras: dict[str, tuple[Element, Value]]
    inputs: dict[str, int] = field(default_factory=dict)
    outputs: dict[str, int] = field(default_factory=dict)
    inhibitors: dict[str, int] = field(default_factory=dict)


@dataclass(slots=True)
class PnmlGraph:
    """Places and transitions by id; the places of final markings by name, None without any."""

    places: dict[str, PlaceElement] = field(default_factory=dict)
    transitions: dict[str, TransitionElement] = field(default_factory=dict)
    remote: dict[str, str] = field(default_factory=dict)
    final: tuple[str, ...] | None = None


def read_graph(root: Element, net: Element, *, ours: bool) -> PnmlGraph:
    """Read the parts of a net.

    Args:
        root: The file.
        net: The net in it.
        ours: Whether we wrote the file: names of places and transitions are then their names, otherwise their ids.

    Raises:
        NetFileError: An id twice or missing, an arc or reference that leads nowhere, or what is not understood.
    """
    reader = _Reader(frozenset({root.namespace, net.namespace}), ours=ours)
    return reader.read(root, net)


class _Reader:
    def __init__(self, namespaces: frozenset[str], *, ours: bool) -> None:
        self.graph = PnmlGraph()
        self._namespaces, self._ours = namespaces, ours
        self._token_class = ""

    def read(self, root: Element, net: Element) -> PnmlGraph:
        check(root, self._namespaces)
        by_id: dict[str, Element] = {}
        arcs: list[Element] = []
        for element in self._objects(net):
            check(element, self._namespaces)
            if element.tag in ARCS:
                arcs.append(element)
                continue
            identity = element.attributes.get("id", "")
            if not 0 < len(identity) <= _LONGEST_ID:
                raise element.error(f"needs an 'id' of 1 to {_LONGEST_ID} characters")
            if identity in by_id:
                raise element.error(f"the id is there twice; the first is in line {by_id[identity].place.line}")
            by_id[identity] = element
        for identity, element in by_id.items():
            self._node(identity, element)
        for arc in arcs:
            self._arc(arc, _end(by_id, arc, "source"), _end(by_id, arc, "target"))
        for place in self.graph.places.values():
            _check_place(place.element)
        for final in (*net.all("finalmarkings"), *root.all("finalmarkings")):
            self._final(final)
        limited = [place for place in self.graph.places.values() if place.capacity]
        for transition in self.graph.transitions.values():
            _block(transition, limited)
        return self.graph

    def _objects(self, net: Element) -> Iterator[Element]:
        """Return nodes and arcs of all pages, in the order of the file."""
        waiting = [net]
        while waiting:
            element = waiting.pop()
            if element.tag in ("net", "page"):
                check(element, self._namespaces)
                waiting.extend(reversed(list(element.all("page", *NODES, *ARCS))))
            else:
                yield element

    def _node(self, identity: str, element: Element) -> None:
        graph = self.graph
        said = label_text(element, "name") or ""
        name, title = (said or identity, "") if self._ours else (identity, "" if said == identity else said)
        if element.tag == "place":
            extras = read_extras(element)
            if REMOTE in extras:
                entry, value = extras[REMOTE]
                if not value.text or value.is_null:
                    raise entry.error(f"{value.shown()} is not the name of a place of another net")
                graph.remote[identity] = value.text
                return
            tokens = self._black(element, label_count(element, "initialMarking", 0, 0))
            capacity = self._black(element, label_count(element, "capacity", 0, 0))
            graph.places[identity] = PlaceElement(element, name, title, tokens, capacity, extras)
        elif element.tag == "transition":
            graph.transitions[identity] = TransitionElement(
                element, name, title, timing_of(element), read_extras(element)
            )

    def _black(self, element: Element, count: Count) -> int:
        """Return a number of tokens, of a single class in the whole net."""
        if count.token_class and count.number:
            if self._token_class and self._token_class != count.token_class:
                classes = f"{shortened(self._token_class)} and {shortened(count.token_class)}"
                sentence = f"the net has tokens of several classes ({classes}): it is coloured"
                raise element.error(f"{sentence}; place/transition nets are read")
            self._token_class = count.token_class
        return count.number

    def _final(self, element: Element) -> None:
        """Add the places of final markings; a list without any, as ProM writes, says nothing."""
        check(element, self._namespaces)
        found = dict.fromkeys(self.graph.final or ())
        for marking in element.all("marking"):
            check(marking, self._namespaces)
            for entry in marking.all("place"):
                check(entry, self._namespaces, _FINAL)
                identity = entry.attributes.get("idref", "")
                if identity not in self.graph.places:
                    raise entry.error(f"there is no place '{identity[:60]}'{nearest(identity, self.graph.places)}")
                if self._black(entry, counted(replace(entry, attributes={}), 1, 0)):
                    found[self.graph.places[identity].name] = None
            self.graph.final = tuple(found)

    def _arc(self, arc: Element, source: str, target: str) -> None:
        graph, (kind, weight) = self.graph, self._inscribed(arc)
        if source in graph.transitions and (target in graph.places or target in graph.remote):
            if kind != "normal":
                raise arc.error(f"type '{kind}' leads from a place to a transition, not from '{source}' to '{target}'")
            outputs = graph.transitions[source].outputs
            name = graph.remote.get(target) or graph.places[target].name
            outputs[name] = outputs.get(name, 0) + weight
        elif source in graph.places and target in graph.transitions:
            transition, name = graph.transitions[target], graph.places[source].name
            if kind == "inhibitor":
                transition.inhibitors[name] = min(weight, transition.inhibitors.get(name, weight))
                return
            transition.inputs[name] = transition.inputs.get(name, 0) + weight
            if kind == "test":
                transition.outputs[name] = transition.outputs.get(name, 0) + weight
        elif source in graph.remote:
            raise arc.error(f"takes a token from '{graph.remote[source]}', a place of another net")
        else:
            raise arc.error(f"joins '{source}' and '{target}'; an arc joins a place and a transition")

    def _inscribed(self, arc: Element) -> tuple[str, int]:
        """Return kind and weight of an arc, from all that says them."""
        kinds = [label_text(arc, "type") or "", label_text(arc, "arctype") or "", "" if arc.tag == "arc" else arc.tag]
        inscription = find_label(arc, "inscription")
        if inscription is not None:
            wrapper = next((each for each in inscription.children if each.tag in _WRAPPERS), None)
            if wrapper is not None:
                kinds.append(wrapper.tag)
                inscription = _unwrapped(wrapper)
            elif (text := _plain_text(inscription)).startswith(("[", "(")):
                _check_age(inscription, text)
                inscription = None
        said = Count(1) if inscription is None else counted(inscription, 1, 1)
        weight = label_count(arc, "weight", said.number, 1)
        if said.number not in (1, weight.number):
            raise arc.error(f"says the weights {weight.number} and {said.number}; one is allowed")
        self._black(arc, said)
        name = label_text(arc, "name") or ""
        if arc.first("arctype") is not None and name.isdigit() and int(name) != weight.number:
            raise arc.error(f"says the weight {name} in its name, and {weight.number} otherwise; one is allowed")
        return _kind(arc, [kind for kind in kinds if kind]), self._black(arc, weight)


def _kind(arc: Element, said: list[str]) -> str:
    """Return the kind of an arc: normal, inhibitor or test."""
    found: dict[str, None] = {}
    for kind in said:
        if kind not in _KINDS:
            raise arc.error(f"type '{kind[:60]}' is not understood; allowed are normal, inhibitor and test")
        found[_KINDS[kind]] = None
    if len(found) > 1:
        raise arc.error(f"says the types {' and '.join(found)}; one is allowed")
    return next(iter(found), "normal")


def _plain_text(label: Element) -> str:
    texts = (child.text for child in label.all("text", "value"))
    return next(texts, label.attributes.get("value", label.text)).strip()


def _unwrapped(wrapper: Element) -> Element:
    """Return the annotation of an inhibitor or test arc of SNAKES, whose condition must hold always."""
    if wrapper.tag == "test":
        return wrapper
    condition = wrapper.first("condition")
    said = condition.children[0].text.strip() if condition is not None and condition.children else "True"
    annotation = wrapper.first("annotation")
    if said != "True" or annotation is None:
        raise wrapper.error(f"the condition {quoted_text(said)} looks at values, of a coloured net; allowed is True")
    return annotation


def _check_age(inscription: Element, text: str) -> None:
    """Refuse an arc that takes tokens of some ages alone; the number behind a colon pairs transport arcs of TAPAAL."""
    interval = interval_of(inscription, text.partition(":")[0])
    if not interval.is_any:
        sentence = f"takes tokens of age {interval.shown} alone; tokens have no age here, and [0,inf) is allowed"
        raise inscription.error(sentence)


def _check_place(place: Element) -> None:
    """Refuse a place whose tokens may not grow older than some age, or are not black."""
    invariant = label_text(place, "invariant") or ""
    if re.fullmatch(r"<=?\s*inf", invariant.strip()) is None and invariant:
        sentence = f"invariant {quoted_text(invariant)} bounds the age of its tokens; tokens have no age here"
        raise place.error(f"{sentence}, and '< inf' is allowed")
    kind = place.first("type")
    if kind is not None and (kind.children or kind.text.strip() or kind.attributes != {"domain": "universal"}):
        raise kind.error("is of a coloured net; place/transition nets are read")


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
