"""Parts of TAPAAL's files that say nothing of an uncoloured net: terms of black dots, and times of chance.

Since version 4 TAPAAL writes the terms of coloured nets for each net, and a distribution for each transition.
"""

from collections.abc import Iterator
from typing import Final

from im_pnt.pnml.element import Element
from im_pnt.pnml.label import label_count

_COUNTS: Final = {"hlinitialMarking": "initialMarking", "hlinscription": "weight"}
_DOTS: Final = frozenset(["text", "structure", "add", "subterm", "numberof", "numberconstant", "positive"])
_SORTS: Final = frozenset(["text", "structure", "declarations", "namedsort", "dot", "usersort"])
_CHANCE: Final = frozenset(
    [
        "distribution",
        "firingMode",
        "weight",
        "value",
        "a",
        "b",
        "c",
        "rate",
        "mean",
        "stddev",
        "shape",
        "scale",
        "p",
        "logMean",
        "logStddev",
    ]
)


def drop_silent_parts(root: Element) -> None:
    """Remove parts without a meaning from a file: terms of dots whose number is said otherwise, and unused times.

    Raises:
        NetFileError: A term and an attribute say different numbers of dots.
    """
    feature = root.first("feature")
    timeless = feature is not None and feature.attributes.get("isStochastic") == "false"
    waiting = [root]
    while waiting:
        element = waiting.pop()
        waiting.extend(element.all("net", "page", "place", "transition", "arc"))
        element.children = [child for child in element.children if not _says_nothing(element, child)]
        if timeless and element.tag == "transition":
            element.attributes = {name: text for name, text in element.attributes.items() if name not in _CHANCE}


def _says_nothing(element: Element, child: Element) -> bool:
    if child.tag in ("declaration", "type"):
        names = {name for part in _inside(child) for name in part.attributes.values()}
        return names == {"dot"} and all(part.tag in _SORTS for part in _inside(child))
    if child.tag not in _COUNTS:
        return False
    terms = [part for part in _inside(child) if part.tag not in _DOTS]
    if not terms or any(part.tag != "useroperator" or part.attributes != {"declaration": "dot"} for part in terms):
        return False
    number = sum(label_count(part, "value", 0, 0).number for part in _inside(child) if part.tag == "numberconstant")
    said = label_count(element, _COUNTS[child.tag], 0, 0).number
    if number != said:
        raise child.error(f"says {number} dots, and {_COUNTS[child.tag]} {said}; one number is allowed")
    return True


def _inside(element: Element) -> Iterator[Element]:
    for child in element.children:
        yield child
        yield from _inside(child)
