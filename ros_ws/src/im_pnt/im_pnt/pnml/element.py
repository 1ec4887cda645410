"""XML to elements with the line; without document types and entities, in bounded time and memory.

The labels of elements are read as the standard and as tools write them.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from im_core.errors import quoted_text, shortened
from im_core.yamltext import Kind, Value
from im_pnt.errors import NetFileError
from im_pnt.model.net import LARGEST

MAX_DEPTH = 100
MAX_ELEMENTS = 1_000_000

_WHOLE = re.compile(r"\+?0*([0-9]{1,10})")
_COLOURED = frozenset({"hlinitialMarking", "hlinscription", "declaration", "structure", "condition", "colorType"})


@dataclass(slots=True)
class Element:
    """An XML element.

    Attributes:
        tag: Name without namespace.
        namespace: Its namespace, empty where it has none.
        attributes: Attributes, by names without namespace.
        place: Where it stands.
        children: Elements in it.
        text: Text directly in it.
    """

    tag: str
    namespace: str
    attributes: dict[str, str]
    place: Value
    children: list["Element"] = field(default_factory=list)
    text: str = ""

    def all(self, *tags: str) -> Iterator["Element"]:
        """Iterate over the children of some names."""
        return (child for child in self.children if child.tag in tags)

    def first(self, tag: str) -> "Element | None":
        """Return the first child of a name."""
        return next(self.all(tag), None)

    def error(self, message: str) -> NetFileError:
        """Make an error with the element, the file and line."""
        identity = f" '{self.attributes['id'][:60]}'" if "id" in self.attributes else ""
        place = self.place
        return NetFileError(place.file, place.line, f"{shortened(self.tag)}{identity}: {message}", place.column)


def parse_xml(data: bytes, file: str) -> Element:
    """Parse an XML document.

    Args:
        data: The document.
        file: Its name in messages.

    Raises:
        NetFileError: Not XML, with a document type, or with more elements or deeper nesting than a net can need.
    """
    builder = _Builder(file)
    parser = expat.ParserCreate(namespace_separator=" ")
    builder.parser = parser
    parser.buffer_text = True
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.characters
    parser.StartDoctypeDeclHandler = builder.doctype
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        message = expat.ErrorString(error.code)
        raise NetFileError(file, error.lineno, f"not XML: {message}", error.offset + 1) from error
    except (ValueError, LookupError) as error:
        raise NetFileError(file, 1, f"not XML: {error}", 1) from error
    assert builder.root is not None
    return builder.root


def label_text(element: Element, label: str) -> str | None:
    """Return the text of a label: ``<text>``, ``<value>``, the element, or an attribute; None without one."""
    child = element.first(label)
    if child is None:
        return element.attributes.get(label)
    inner = child.first("text") or child.first("value")
    return (inner.text if inner is not None else child.attributes.get("value", child.text)).strip()


def label_integer(element: Element, label: str, default: int, minimum: int) -> int:
    """Return the whole number of a label.

    Raises:
        NetFileError: It is none, or too small or too large.
    """
    text = label_text(element, label)
    if not text:
        return default
    match = _WHOLE.fullmatch(text.removeprefix("Default,").strip())
    value = int(match.group(1)) if match else -1
    if not minimum <= value <= LARGEST:
        sentence = f"{quoted_text(text)} is not a whole number from {minimum} to {LARGEST}"
        raise (element.first(label) or element).error(sentence)
    return value


def check_children(element: Element, namespace: str, known: frozenset[str]) -> None:
    """Refuse children of an element with an unknown effect on the net.

    Raises:
        NetFileError: It does; names the element and what is allowed.
    """
    for child in element.children:
        if child.namespace not in ("", namespace) or child.tag in known:
            continue
        if child.tag in _COLOURED or child.first("structure") is not None:
            raise child.error(f"is of a coloured net (in {shortened(element.tag)}); place/transition nets are read")
        raise child.error(f"is not understood in {shortened(element.tag)}; allowed are {', '.join(sorted(known))}")


class _Builder:
    def __init__(self, file: str) -> None:
        self.root: Element | None = None
        self.parser: expat.XMLParserType | None = None
        self._file = file
        self._open: list[Element] = []
        self._texts: list[list[str]] = []
        self._count = 0

    def start(self, name: str, attributes: dict[str, str]) -> None:
        namespace, _, tag = name.rpartition(" ")
        self._count += 1
        named = {key.rpartition(" ")[2]: text for key, text in attributes.items()}
        element = Element(tag, namespace, named, self._at())
        if len(self._open) >= MAX_DEPTH:
            raise element.error(f"elements nest deeper than {MAX_DEPTH}")
        if self._count > MAX_ELEMENTS:
            raise element.error(f"more than {MAX_ELEMENTS} elements; a net file may not have as many")
        if self._open:
            self._open[-1].children.append(element)
        else:
            self.root = element
        self._open.append(element)
        self._texts.append([])

    def end(self, _name: str) -> None:
        self._open.pop().text = "".join(self._texts.pop())

    def characters(self, text: str) -> None:
        self._texts[-1].append(text)

    def doctype(self, name: str, *_: object) -> None:
        place = self._at()
        raise NetFileError(self._file, place.line, f"document type '{name[:60]}' is not allowed", place.column)

    def _at(self) -> Value:
        assert self.parser is not None
        line, column = self.parser.CurrentLineNumber, self.parser.CurrentColumnNumber + 1
        return Value(Kind.MAPPING, self._file, line, column)
