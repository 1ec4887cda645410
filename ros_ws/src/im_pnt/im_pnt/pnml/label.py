"""Labels of PNML elements, read by what their content says: a text, a count, or black tokens.

The standard writes ``<text>``, PIPE ``<value>`` with the class of the tokens before the number, TAPAAL attributes of
the element, SNAKES multisets of values.
"""

import re
from collections.abc import Iterator
from typing import NamedTuple

from im_core.errors import quoted_text, shortened
from im_pnt.model.net import LARGEST
from im_pnt.pnml.element import Element

_WHOLE = re.compile(r"\+?0*([0-9]{1,10})")
_NUMBER = re.compile(r"\+?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_TEXTS = ("text", "value", "count")
_ENDLESS = frozenset({"inf", "infty", "infinity", "w", "\u03c9", "\u221e"})
_INTERVAL = re.compile(r"([\[\](])\s*([^\s,;]+)\s*[,;]\s*([^\s,;]+?)\s*([\[\])])")
_CLOSURES = {"closed": "[]", "open": "()", "closed-open": "[)", "open-closed": "(]"}


class Count(NamedTuple):
    """Whole number of a label, and the class of the tokens; an empty one where the label names none."""

    number: int
    token_class: str = ""


class TimeInterval(NamedTuple):
    """TimeInterval of times; an upper bound of None is no bound."""

    low: float
    high: float | None
    shown: str

    @property
    def is_any(self) -> bool:
        """Whether every time from 0 on is in it."""
        return self.high is None and self.low == 0.0 and self.shown.startswith("[")


def find_label(element: Element, label: str) -> Element | None:
    """Return the label of an element: a child, or an attribute as one; None without one.

    Raises:
        NetFileError: It is there twice.
    """
    found = list(element.all(label))
    if label in element.attributes:
        identity = element.attributes.get("id", "")
        within = f"{element.tag} '{identity[:60]}'" if identity else ""
        found.insert(0, Element(label, "", {}, element.place, text=element.attributes[label], within=within))
    if len(found) > 1:
        raise found[1].error(f"is there twice in {shortened(element.tag)}")
    return found[0] if found else None


def label_text(element: Element, label: str) -> str | None:
    """Return the text of a label; None without one.

    Raises:
        NetFileError: It is there twice, or its content is not known.
    """
    found = find_label(element, label)
    return None if found is None else _text(found)


def label_count(element: Element, label: str, default: int, minimum: int) -> Count:
    """Return the whole number of a label; an empty text is the default.

    Raises:
        NetFileError: It is none, or too small or too large; or its content is not known, or is not of black tokens.
    """
    found = find_label(element, label)
    return Count(default) if found is None else counted(found, default, minimum)


def counted(label: Element, default: int, minimum: int) -> Count:
    """Return the whole number that a label says, as :func:`label_count` does."""
    content = list(_content(label))
    if any(child.children or child.tag not in _TEXTS for child in content):
        _require_alone(label, content)
        number, token_class = sum(_tokens(child) for child in content), ""
        shown = str(number)
    else:
        shown = _text(label)
        if not shown:
            return Count(default)
        number, token_class = _number(label, shown)
    if not minimum <= number <= LARGEST:
        raise label.error(f"{quoted_text(shown)} is not a whole number from {minimum} to {LARGEST}")
    return Count(number, token_class)


def label_flag(element: Element, label: str) -> bool | None:
    """Return the truth value of a label; None without one.

    Raises:
        NetFileError: It is neither true nor false.
    """
    text = label_text(element, label)
    if not text:
        return None
    if text.lower() not in ("true", "false"):
        raise (find_label(element, label) or element).error(f"{quoted_text(text)} is neither true nor false")
    return text.lower() == "true"


def label_number(element: Element, label: str) -> float | None:
    """Return the number of a label, > 0; None without one.

    Raises:
        NetFileError: It is none, or not above 0.
    """
    text = label_text(element, label)
    if not text:
        return None
    if not _NUMBER.fullmatch(text) or not 0.0 < float(text) < float("inf"):
        raise (find_label(element, label) or element).error(f"{quoted_text(text)} is not a number > 0")
    return float(text)


def label_interval(element: Element, label: str) -> TimeInterval | None:
    """Return the interval of a label, written as ``[0,inf)``, ``[0,w[`` or in MathML; None without one.

    Raises:
        NetFileError: It is none.
    """
    found = find_label(element, label)
    if found is None:
        return None
    markup = found.first("interval")
    if markup is None:
        return interval_of(found, _text(found))
    closure = markup.attributes.get("closure", "closed")
    bounds = [child.text.strip() for child in markup.children]
    if closure not in _CLOSURES or len(bounds) != 2 or any(child.children for child in markup.children):
        raise markup.error("is not an interval of two bounds, whose closure is " + ", ".join(_CLOSURES))
    brackets = _CLOSURES[closure]
    return interval_of(found, f"{brackets[0]}{bounds[0]},{bounds[1]}{brackets[1]}")


def interval_of(label: Element, text: str) -> TimeInterval:
    """Return the interval that a text says.

    Raises:
        NetFileError: It says none.
    """
    match = _INTERVAL.fullmatch(text.strip())
    low, high = (match[2], match[3]) if match else ("", "")
    endless = high.lower() in _ENDLESS
    if not _NUMBER.fullmatch(low) or not (endless or _NUMBER.fullmatch(high)):
        raise label.error(f"{quoted_text(text)} is not an interval, such as [0,inf)")
    return TimeInterval(float(low), None if endless else float(high), text.strip())


def _content(label: Element) -> Iterator[Element]:
    return (child for child in label.children if child.tag not in ("graphics", "toolspecific"))


def _text(label: Element) -> str:
    content = list(_content(label))
    for name in label.attributes:
        if name != "value":
            raise label.error(f"attribute '{shortened(name)}' is not understood; allowed is value")
    if not content:
        return label.attributes.get("value", label.text).strip()
    for child in content:
        if child.tag not in _TEXTS or child.children or child.attributes or len(content) > 1:
            raise child.error(f"is not understood in {shortened(label.tag)}; allowed is one of {', '.join(_TEXTS)}")
    _require_alone(label, content)
    return content[0].text.strip()


def _require_alone(label: Element, content: list[Element]) -> None:
    if label.attributes or label.text.strip():
        raise label.error(f"says another thing beside {content[0].tag}; one of them is allowed")


def _number(label: Element, text: str) -> tuple[int, str]:
    """Return the number of a text, and the class of the tokens where it names classes, as in ``Default,1``."""
    parts = [part.strip() for part in text.split(",")]
    pairs = list(zip(parts[::2], parts[1::2], strict=False)) if len(parts) % 2 == 0 else [("", text)]
    numbers = [(name, _whole(number)) for name, number in pairs]
    some = [(name, number) for name, number in numbers if number]
    if any(number < 0 for _, number in numbers):
        return -1, ""
    if len(some) > 1:
        names = " and ".join(shortened(name) for name, _ in some)
        raise label.error(
            f"holds tokens of several classes ({names}), of a coloured net; place/transition nets are read"
        )
    return (some[0][1], some[0][0]) if some else (0, "")


def _whole(text: str) -> int:
    match = _WHOLE.fullmatch(text)
    return int(match.group(1)) if match else -1


def _tokens(element: Element) -> int:
    """Return the number of black tokens of an element of SNAKES."""
    match element.tag:
        case "multiset" | "multiarc":
            return sum(map(_tokens, element.children))
        case "token" if not element.children:
            return 1
        case "value" if len(element.children) == 1:
            return _tokens(element.children[0])
        case "item":
            value, many = element.first("value"), element.first("multiplicity")
            if value is not None and many is not None and len(element.children) == 2:
                return _tokens(value) * max(_whole(many.text.strip()), -LARGEST)
    raise element.error("is not understood; black tokens are counted, as in <value><token/></value>")
