"""PNML files to nets: of the standard, and of tools.

No namespace, no page, ``<value>`` for ``<text>``, labels as attributes and no initial marking are fine. Each element
and attribute is understood, means nothing (:mod:`.check` names it), or is refused by name.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from im_core.errors import nearest, quoted_text, shortened
from im_core.text.yamltext import Value, as_data, mapping, scalar
from im_pnt.model.net import Net
from im_pnt.netfile.reader import read_net
from im_pnt.netfile.schema.names import MAX_NAME, as_name
from im_pnt.netfile.schema.net import NetFile
from im_pnt.netfile.schema.scalars import written
from im_pnt.netfile.schema.values import ARCS
from im_pnt.netfile.text import checked, read_bytes
from im_pnt.pnml.element import Element, parse_xml
from im_pnt.pnml.extras import plain_value, read_extras
from im_pnt.pnml.graph import PnmlGraph, read_graph
from im_pnt.pnml.label import label_text
from im_pnt.pnml.silent import drop_silent_parts
from im_pnt.pnml.timing import timing_keys

MAX_SIZE = 32 * 2**20
"""Largest PNML file [bytes]."""

_COLOURED = re.compile(r"symmetricnet|highlevelnet|pt-hlpng|hlpn|colou?red|algebraic", re.IGNORECASE)
_PLAIN = re.compile(r"|.*(p/?t[ _-]?net|ptnetb|pnmlcoremodel|basic|epnml|tpn|gspn|spn).*", re.IGNORECASE)
_TYPES = "place/transition nets are read: http://www.pnml.org/version-2009/grammar/ptnet"


def load_pnml(path: Path, within: Sequence[Path] = ()) -> Net:
    """Read a net from a PNML file.

    Args:
        path: The file; ``FILE#net`` for one net of several, by id or name.
        within: Folders that the file must lie in; empty: it may lie anywhere.

    Raises:
        NetFileError: Not PNML, not a place/transition net, or several nets of which none is asked for.
    """
    file, wanted = path, ""
    if "#" in path.name and not path.exists():
        name, _, wanted = path.name.partition("#")
        file = path.with_name(name)
    root = parse_xml(read_bytes(file, MAX_SIZE, within), str(file))
    if root.tag != "pnml":
        raise root.error("is not the root of a PNML file; 'pnml' is")
    drop_silent_parts(root)
    nets = list(root.all("net"))
    if not nets:
        raise root.error("holds no 'net'")
    return _net(root, _chosen(root, nets, wanted, file))


def _chosen(root: Element, nets: list[Element], wanted: str, file: Path) -> Element:
    names = [net.attributes.get("id") or label_text(net, "name") or "" for net in nets]
    if wanted:
        for net in nets:
            if wanted in (net.attributes.get("id"), label_text(net, "name")):
                return net
        raise root.error(f"there is no net {quoted_text(wanted)}{nearest(wanted, names)}")
    if len(nets) > 1:
        listed = shortened(", ".join(names[:30]), 40)
        raise root.error(f"holds {len(nets)} nets: {listed}; say which, as in {file}#{shortened(names[0], 20)}")
    return nets[0]


def _net(root: Element, net: Element) -> Net:
    kind = net.attributes.get("type", "")
    if _COLOURED.search(kind):
        raise net.error(f"type '{kind[:100]}' is a coloured or high-level net; {_TYPES}")
    if not _PLAIN.fullmatch(kind):
        raise net.error(f"type '{kind[:100]}' is not understood; {_TYPES}")
    extras = read_extras(net)
    graph = read_graph(root, net, ours=bool(extras))
    place = net.place
    pairs: dict[str, Value] = {key: value for key, (_, value) in extras.items()}
    identity = net.attributes.get("id", "")
    if "net" not in pairs:
        pairs["net"] = scalar(as_name(identity or label_text(net, "name") or "net"), place)
        name = (label_text(net, "name") or "").strip()
        if name and name != identity:
            pairs["description"] = scalar(" ".join(name.split())[:MAX_NAME], place)
    if graph.final is not None:
        pairs["rest"] = plain_value(list(graph.final), place)
    pairs["places"] = mapping(_places(graph), place)
    pairs["transitions"] = mapping(_transitions(graph), place)
    whole = mapping([(scalar(key, value), value) for key, value in pairs.items()], place)
    return read_net(whole, foreign=True)


def _places(graph: PnmlGraph) -> list[tuple[Value, Value]]:
    pairs = []
    for place in graph.places.values():
        given = {"title": place.title, "tokens": place.tokens, "capacity": place.capacity}
        value = _mapping(place.element, place.extras, **given)
        pairs.append((scalar(place.name, place.element.place), value))
    return pairs


def _transitions(graph: PnmlGraph) -> list[tuple[Value, Value]]:
    pairs = []
    timings = timing_keys(transition.timing for transition in graph.transitions.values())
    for transition, timing in zip(graph.transitions.values(), timings, strict=True):
        given: dict[str, object] = {"title": transition.title, "in": transition.inputs, "out": transition.outputs}
        own = _inhibitors(transition.element, transition.extras)
        inhibitors = dict(own)
        for name, weight in transition.inhibitors.items():
            inhibitors[name] = min(weight, inhibitors.get(name, weight))
        extras = {key: value for key, value in transition.extras.items() if key != "inhibitors"}
        value = _mapping(transition.element, extras, **given, **timing, inhibitors=inhibitors)
        pairs.append((scalar(transition.name, transition.element.place), value))
    return pairs


def _inhibitors(element: Element, extras: Mapping[str, tuple[Element, Value]]) -> dict[str, int]:
    if "inhibitors" not in extras:
        return {}
    value = extras["inhibitors"][1]
    root = mapping([(scalar("inhibitors", value), value)], element.place)
    return checked(root, as_data(value, written), NetFile, ARCS.validate_python, ("inhibitors",))


def _mapping(element: Element, extras: Mapping[str, tuple[Element, Value]], **given: object) -> Value:
    """Return the keys of PNML proper, and our own keys."""
    place = element.place
    pairs = [(scalar(key, place), plain_value(data, place)) for key, data in given.items() if data]
    for key, (entry, value) in extras.items():
        if given.get(key):
            raise entry.error(f"'{key}' is said by PNML itself")
        pairs.append((scalar(key, entry.place), value))
    return mapping(pairs, place)
