"""Parts of a PNML file: understood, without meaning, or refused by name; nothing else passes.

Without meaning is what the standard calls graphics and tool specific, and what editors write about their own state.
"""

from dataclasses import dataclass
from typing import Final

from im_core.errors import quoted_text, shortened
from im_pnt.pnml.element import Element

NODES: Final = ("place", "transition", "referencePlace", "referenceTransition")
ARCS: Final = ("arc", "inputArc", "outputArc", "inhibitorArc")

_SEVERAL = frozenset({*NODES, *ARCS, "net", "page", "token", "toolspecific", "marking"})
_ANYWHERE = frozenset({"graphics", "toolspecific", "label", "labels", "description"})
_DRAWN = frozenset({"positionX", "positionY", "nameOffsetX", "nameOffsetY", "displayName"})
"""Attributes by which TAPAAL draws."""
_COLOURED = frozenset({"hlinitialMarking", "hlinscription", "declaration", "structure", "condition", "colorType"})


@dataclass(frozen=True, slots=True)
class Known:
    """Known parts of an element.

    Attributes:
        children: Understood elements in it.
        silent: Elements in it without meaning.
        attributes: Understood attributes.
        silent_attributes: Attributes without meaning.
    """

    children: frozenset[str] = frozenset()
    silent: frozenset[str] = frozenset()
    attributes: frozenset[str] = frozenset()
    silent_attributes: frozenset[str] = frozenset()


def _known(children: str = "", silent: str = "", attributes: str = "", silent_attributes: str = "") -> Known:
    return Known(*(frozenset(names.split()) for names in (children, silent, attributes, silent_attributes)))


_OBJECTS = " ".join((*NODES, *ARCS, "page"))
_LABELS = "name initialMarking capacity invariant"
_TIMES = "name timed rate priority weight infiniteServer delay urgent player"
_WEIGHTS = "inscription weight type arctype name"
_PLACE = Known(
    frozenset(f"{_LABELS} type".split()),
    frozenset({"initialMarkingAge"}),
    frozenset(f"id {_LABELS}".split()),
    silent_attributes=_DRAWN | {"markingOffsetX", "markingOffsetY"},
)
_TRANSITION = Known(
    frozenset(_TIMES.split()),
    frozenset({"orientation"}),
    frozenset(f"id {_TIMES}".split()),
    _DRAWN | {"angle"},
)
_ARC = Known(
    frozenset(_WEIGHTS.split()),
    frozenset({"arcpath", "tagged"}),
    frozenset(f"id source target {_WEIGHTS}".split()),
    _DRAWN | {"transportID"},
)
_REFERENCE = _known("name", attributes="id ref name")

_KNOWN = {
    "pnml": _known("net finalmarkings", "query k-bound feature constant", "", "version"),
    "net": _known(
        f"{_OBJECTS} name token tokenclass finalmarkings",
        "stategroup variables definition annotation declare global",
        "id type name",
        "active",
    ),
    "page": _known(f"{_OBJECTS} name", "stategroup annotation", "id name"),
    "place": _PLACE,
    "transition": _TRANSITION,
    **dict.fromkeys(ARCS, _ARC),
    "referencePlace": _REFERENCE,
    "referenceTransition": _REFERENCE,
    "token": _known(attributes="id", silent_attributes="enabled red green blue"),
    "tokenclass": _known(attributes="id", silent_attributes="enabled red green blue"),
    "finalmarkings": _known("marking"),
    "marking": _known("place"),
}
"""Elements by tag. TAPAAL's constants mean nothing: a label that names one is no number, and is refused."""


def check(element: Element, namespaces: frozenset[str], known: Known | None = None) -> None:
    """Refuse what is neither understood nor without meaning in an element.

    Args:
        element: The element.
        namespaces: Namespaces of the file's own elements; an empty one is always its own.
        known: Known parts; None: those of every element of this tag.

    Raises:
        NetFileError: There is such a part; names the element, the part and what is allowed.
    """
    known = known or _KNOWN[element.tag]
    tag = shortened(element.tag)
    for name in element.attributes:
        if name not in known.attributes | known.silent_attributes:
            allowed = ", ".join(sorted(known.attributes)) or "none"
            raise element.error(f"attribute '{shortened(name)}' is not understood; allowed are {allowed}")
    if element.text.strip():
        raise element.error(f"the text {quoted_text(element.text.strip())} is not understood in {tag}")
    seen: set[str] = set()
    for child in element.children:
        own = not child.namespace or child.namespace in namespaces
        if own and child.tag in seen and child.tag in known.children - _SEVERAL:
            raise child.error(f"is there twice in {tag}")
        seen.add(child.tag)
        if own and child.tag in known.children | known.silent | _ANYWHERE:
            continue
        if child.tag in _COLOURED or child.first("structure") is not None:
            raise child.error(f"is of a coloured net (in {tag}); place/transition nets are read")
        allowed = ", ".join(sorted(known.children)) or "none"
        raise child.error(f"is not understood in {tag}; allowed are {allowed}")
