"""Labels of PNML elements, as the standard and as tools write them."""

import re

from im_pnt.netfile.node import LARGEST
from im_pnt.pnml.element import Element

_WHOLE = re.compile(r"\+?0*([0-9]{1,10})")
_COLOURED = frozenset({"hlinitialMarking", "hlinscription", "declaration", "structure", "condition", "colorType"})


def label_text(element: Element, label: str) -> str | None:
    """Returns the text of a label: of ``<text>``, of ``<value>``, of itself, or of an attribute; None without one."""
    child = element.first(label)
    if child is None:
        return element.attributes.get(label)
    inner = child.first("text") or child.first("value")
    return (inner.text if inner is not None else child.attributes.get("value", child.text)).strip()


def label_integer(element: Element, label: str, default: int, minimum: int) -> int:
    """Returns the whole number of a label.

    Raises:
        NetFileError: It is none, or too small or too large.
    """
    text = label_text(element, label)
    if not text:
        return default
    match = _WHOLE.fullmatch(text.removeprefix("Default,").strip())
    value = int(match.group(1)) if match else -1
    if not minimum <= value <= LARGEST:
        shown = text if len(text) <= 60 else text[:60] + "..."
        raise (element.first(label) or element).error(f"'{shown}' is not a whole number from {minimum} to {LARGEST}")
    return value


def check_children(element: Element, namespace: str, known: frozenset[str]) -> None:
    """Sees to it that an element holds nothing that could change what the net means.

    Raises:
        NetFileError: It does; names the element and what is allowed.
    """
    for child in element.children:
        if child.namespace not in ("", namespace) or child.tag in known:
            continue
        if child.tag in _COLOURED or child.first("structure") is not None:
            raise child.error(f"is of a coloured net (in {element.tag}); place/transition nets are read")
        raise child.error(f"is not understood in {element.tag}; allowed are {', '.join(sorted(known))}")
