"""XML to elements with the line; without document types and entities, in bounded time and memory."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from im_core.errors import shortened
from im_core.text.yamltext import Kind, Value
from im_pnt.errors import NetFileError

MAX_DEPTH = 100
MAX_ELEMENTS = 1_000_000

_LATIN = re.compile(rb"<\?xml[^>]*encoding=[\"']iso-8859-1[\"']", re.IGNORECASE)
_ALWAYS = ("http://www.w3.org/XML/1998/namespace", "http://www.w3.org/2001/XMLSchema-instance")
"""Namespaces of attributes about the document itself, which say nothing of the net."""


@dataclass(slots=True)
class Element:
    """An XML element.

    Attributes:
        tag: Name without namespace.
        namespace: Its namespace, empty where it has none.
        attributes: Attributes by name; one of a namespace has that before its name.
        place: Where it stands.
        text: Text directly in it.
        within: Nearest element around it that has an id, for messages; empty without one.
    """

    tag: str
    namespace: str
    attributes: dict[str, str]
    place: Value
    children: list["Element"] = field(default_factory=list)
    text: str = ""
    within: str = ""

    def all(self, *tags: str) -> Iterator["Element"]:
        """Iterate over the children of some names."""
        return (child for child in self.children if child.tag in tags)

    def first(self, tag: str) -> "Element | None":
        """Return the first child of a name."""
        return next(self.all(tag), None)

    def error(self, message: str) -> NetFileError:
        """Make an error with the element, the file and line."""
        identity = f" '{self.attributes['id'][:60]}'" if "id" in self.attributes else ""
        place, within = self.place, f" (in {self.within})" if self.within and not identity else ""
        sentence = f"{shortened(self.tag)}{identity}: {message}{within}"
        return NetFileError(place.file, place.line, sentence, place.column)


def parse_xml(data: bytes, file: str) -> Element:
    """Parse an XML document.

    Raises:
        NetFileError: Not XML, with a document type, or with more elements or deeper nesting than a net can need.
    """
    builder = _Builder(file)
    parser = expat.ParserCreate(_encoding(data), namespace_separator=" ")
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


def _encoding(data: bytes) -> str | None:
    """Return the encoding of a document where the declared one is wrong: some tools declare Latin-1 but write UTF-8."""
    if not _LATIN.match(data):
        return None
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return None
    return "utf-8"


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
        named = {key: text for key, text in attributes.items() if key.rpartition(" ")[0] not in _ALWAYS}
        element = Element(tag, namespace, named, self._at())
        if len(self._open) >= MAX_DEPTH:
            raise element.error(f"elements nest deeper than {MAX_DEPTH}")
        if self._count > MAX_ELEMENTS:
            raise element.error(f"more than {MAX_ELEMENTS} elements; a net file may not have as many")
        if self._open:
            around = self._open[-1]
            around.children.append(element)
            identity = around.attributes.get("id")
            element.within = around.within if identity is None else f"{shortened(around.tag)} '{identity[:60]}'"
        else:
            self.root = element
        self._open.append(element)
        self._texts.append([])

    def end(self, _name: str) -> None:
        self._open.pop().text = "".join(self._texts.pop())

    def characters(self, text: str) -> None:
        self._texts[-1].append(text)

    def doctype(self, name: str, *_: object) -> None:
        place, what = self._at(), f"document type '{name[:60]}' is not allowed"
        if name == "workspaceElements":
            what = "is of CPN Tools, whose nets are coloured; place/transition nets are read"
        raise NetFileError(self._file, place.line, what, place.column)

    def _at(self) -> Value:
        assert self.parser is not None
        line, column = self.parser.CurrentLineNumber, self.parser.CurrentColumnNumber + 1
        return Value(Kind.MAPPING, self._file, line, column)
