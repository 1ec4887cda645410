"""YAML text to values with the place in the file, in bounded time and memory for any text.

The parser's events are put together here instead of by the library, whose own composer recurses as deep as the text
nests, and lets a few aliases stand for billions of values. Unquoted words are read as YAML 1.2 does: ``on`` and ``yes``
are texts.
"""

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

import yaml

from im_core.errors import SHOWN, quoted_text, shortened

MAX_DEPTH = 40
MAX_VALUES = 500_000

_NULL = frozenset({"", "~", "null", "Null", "NULL"})
_BOOLEAN = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]{0,19})")
_FLOAT = re.compile(r"[-+]?((0|[1-9][0-9]*)(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]{1,5})?")
_NOT_FINITE = re.compile(r"([-+]?)\.(inf|Inf|INF|nan|NaN|NAN)")
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")
"""Characters that no text of a person has, or that no XML file can hold."""

_STRING_TAGS = frozenset({None, "!", "tag:yaml.org,2002:str"})
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
#: Texts that a reader of YAML takes for something else unless they are quoted: ours, one of YAML 1.1, that of rcl.
_TAKEN = re.compile(r"[-+.\d].*|~|null|true|false|yes|no|on|off|y|n|inf|infinity|nan(\(.*\))?", re.IGNORECASE)

Location = tuple[int | str, ...]
"""Keys and indices that lead from the root of a file to a value."""


class Kind(Enum):
    """Kind of a value."""

    SCALAR = "scalar"
    LIST = "list"
    MAPPING = "mapping"


@dataclass(frozen=True, slots=True)
class Value:
    """Value as written in a file of any format.

    Attributes:
        kind: Scalar, list or mapping.
        file: File it stands in.
        line: Line, from 1.
        column: Column, from 1.
        text: Text of a scalar.
        quoted: Whether a scalar is text whatever it looks like.
        children: Elements of a list.
        pairs: Keys and values of a mapping, in the author's order; a key may be there twice.
        note: What else a complaint should say: the template and its use.
    """

    kind: Kind
    file: str
    line: int
    column: int
    text: str = ""
    quoted: bool = False
    children: tuple["Value", ...] = ()
    pairs: tuple[tuple["Value", "Value"], ...] = ()
    note: str = ""

    @property
    def is_null(self) -> bool:
        """Whether nothing is written here."""
        return self.kind is Kind.SCALAR and not self.quoted and self.text in _NULL

    def shown(self) -> str:
        """Return a short form for messages."""
        if self.kind is not Kind.SCALAR:
            return "a mapping" if self.kind is Kind.MAPPING else "a list"
        return "nothing" if self.is_null else quoted_text(self.text)


class Quotation:
    """Quotes parts of a file for one error: :data:`SHOWN` characters altogether."""

    def __init__(self) -> None:
        self._left = SHOWN

    def __call__(self, text: str) -> str:
        """Return the beginning of a text in quotes."""
        return repr(self.cut(text))

    def cut(self, text: str) -> str:
        """Return the beginning of a text."""
        shown = shortened(text, self._left)
        self._left -= min(self._left, len(text))
        return shown


def scalar(text: str, near: Value, *, quoted: bool = True) -> Value:
    """Make a scalar at the place of another value."""
    return Value(Kind.SCALAR, near.file, near.line, near.column, text=text, quoted=quoted, note=near.note)


def sequence(children: Iterable[Value], near: Value) -> Value:
    """Make a list at the place of another value."""
    return Value(Kind.LIST, near.file, near.line, near.column, children=tuple(children), note=near.note)


def mapping(pairs: Iterable[tuple[Value, Value]], near: Value) -> Value:
    """Make a mapping at the place of another value."""
    return Value(Kind.MAPPING, near.file, near.line, near.column, pairs=tuple(pairs), note=near.note)


class YamlError(ValueError):
    """Refused text.

    Args:
        place: What is wrong, or stands nearest to it.
        sentence: What is wrong.
        location: The way there.
    """

    def __init__(self, place: Value, sentence: str, location: Location = ()) -> None:
        super().__init__(sentence)
        self.place = place
        self.sentence = sentence
        self.location = location


class RepeatedKeyError(YamlError):
    """A mapping has a key twice.

    Args:
        first: The key where it is first.
        second: The key where it is again.
        location: The way to the mapping.
    """

    def __init__(self, first: Value, second: Value, location: Location) -> None:
        where = f"line {first.line}" if first.file == second.file else f"{first.file}:{first.line}"
        where += first.note if first.note != second.note else ""
        super().__init__(second, f"{quoted_text(second.text)} is there twice; the first is in {where}", location)


class Found(NamedTuple):
    """How far a location leads in a file.

    Attributes:
        value: The innermost value on the way that is there.
        key: Key that it stands under, None in a list and at the root.
        location: The way to it.
    """

    value: Value
    key: Value | None
    location: Location


def find(root: Value, location: Location) -> Found:
    """Follow a location to the deepest existing value; a value without a list counts as a list of one."""
    value, key, way = root, None, list[int | str]()
    for part in location:
        if isinstance(part, int) and value.kind is not Kind.LIST:
            if part == 0:
                continue
            break
        if isinstance(part, int):
            if part >= len(value.children):
                break
            key, value = None, value.children[part]
        else:
            pair = next((pair for pair in value.pairs if pair[0].text == part), None)
            if pair is None:
                break
            key, value = pair
        way.append(part)
    return Found(value, key, tuple(way))


def plain_scalar(value: Value) -> object:
    """Return a scalar as plain Python; a whole number of more than 20 digits is a float."""
    text = value.text
    if value.quoted:
        return text
    if text in _NULL:
        return None
    if text in _BOOLEAN:
        return _BOOLEAN[text]
    if text[0] not in "+-.0123456789":
        return text
    if _INTEGER.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    if match := _NOT_FINITE.fullmatch(text):
        number = math.inf if match.group(2).lower() == "inf" else math.nan
        return -number if match.group(1) == "-" else number
    return text


def as_data(value: Value, scalar_data: Callable[[Value], object] = plain_scalar, location: Location = ()) -> object:
    """Return a value as plain Python: dictionaries, lists, and converted scalars.

    Raises:
        YamlError: A key is there twice, or is not a text.
    """
    if value.kind is Kind.SCALAR:
        return scalar_data(value)
    if value.kind is Kind.LIST:
        return [as_data(child, scalar_data, (*location, rank)) for rank, child in enumerate(value.children)]
    data: dict[str, object] = {}
    for key, child in value.pairs:
        name = key.text
        if key.kind is not Kind.SCALAR or key.is_null:
            raise YamlError(key, f"{key.shown()} is not a text", location)
        if sentence := control_character(name):
            raise YamlError(key, sentence, location)
        if name in data:
            raise RepeatedKeyError(next(first for first, _ in value.pairs if first.text == name), key, location)
        data[name] = as_data(child, scalar_data, (*location, name))
    return data


def control_character(text: str) -> str:
    """Return the forbidden character of a text; empty without one."""
    match = _CONTROL.search(text)
    return f"control character U+{ord(match.group()):04X} is not allowed in a text" if match else ""


@dataclass(slots=True)
class _Open:
    """List or mapping without the end so far."""

    event: yaml.NodeEvent
    children: list[Value] = field(default_factory=list)
    size: int = 1


def read_yaml(text: str, file: str) -> Value:
    """Parse one YAML document.

    Raises:
        YamlError: Not YAML, empty, more than one document, tags, aliases that contain themselves, or more values or
            deeper nesting than a file can need.
    """
    composer = _Composer(file)
    try:
        for event in yaml.parse(text, Loader=_LOADER):
            composer.add(event)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line, column = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        line = min(line, text.count("\n") + 1)  # the parser counts the end as a line of its own
        place = Value(Kind.SCALAR, file, line, column)
        raise YamlError(place, f"not YAML: {error.problem or error.context}") from error
    except (yaml.YAMLError, UnicodeError) as error:
        raise YamlError(Value(Kind.SCALAR, file, 1, 1), f"not YAML: {' '.join(str(error).split())}") from error
    if composer.root is None:
        raise YamlError(Value(Kind.SCALAR, file, 1, 1), "the file is empty")
    return composer.root


def write_yaml(data: object) -> str:
    """Write plain data as YAML, keys in the order; a text is read back as a text by any reader."""
    text: str = yaml.dump(data, Dumper=_Dumper, sort_keys=False)
    return text


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]  # there is no C on every computer
    """Dumper with quotes around ambiguous texts."""

    def represent_text(self, text: str) -> yaml.ScalarNode:
        """Represent a text, quoted where needed."""
        style = "'" if _TAKEN.fullmatch(text) else None
        node: yaml.ScalarNode = self.represent_scalar("tag:yaml.org,2002:str", text, style=style)
        return node


_Dumper.add_representer(str, _Dumper.represent_text)


class _Composer:
    """Puts events together to one value."""

    def __init__(self, file: str) -> None:
        self.root: Value | None = None
        self._file = file
        self._open: list[_Open] = []
        self._anchors: dict[str, tuple[Value, int]] = {}
        self._documents = 0

    def add(self, event: yaml.Event) -> None:
        match event:
            case yaml.DocumentStartEvent():
                self._documents += 1
                if self._documents > 1:
                    raise self._error(event, "a second document begins; one a file is allowed")
            case yaml.AliasEvent():
                self._alias(event)
            case yaml.ScalarEvent():
                if event.tag not in _STRING_TAGS:
                    raise self._error(event, f"tag {quoted_text(str(event.tag))} is not allowed")
                quoted = event.style in ("'", '"', "|", ">") or event.tag is not None
                value = Value(Kind.SCALAR, self._file, *_position(event), text=event.value, quoted=quoted)
                self._complete(value, 1, event.anchor)
            case yaml.SequenceStartEvent() | yaml.MappingStartEvent():
                if event.tag not in (None, "!"):
                    raise self._error(event, f"tag {quoted_text(str(event.tag))} is not allowed")
                if len(self._open) >= MAX_DEPTH:
                    raise self._error(event, f"values nest deeper than {MAX_DEPTH}")
                self._open.append(_Open(event))
            case yaml.SequenceEndEvent() | yaml.MappingEndEvent():
                self._close()

    def _close(self) -> None:
        ended = self._open.pop()
        children, position = ended.children, _position(ended.event)
        if isinstance(ended.event, yaml.SequenceStartEvent):
            value = Value(Kind.LIST, self._file, *position, children=tuple(children))
        else:
            pairs = tuple(zip(children[::2], children[1::2], strict=True))
            value = Value(Kind.MAPPING, self._file, *position, pairs=pairs)
        self._complete(value, ended.size, ended.event.anchor)

    def _alias(self, event: yaml.AliasEvent) -> None:
        if any(event.anchor == each.event.anchor for each in self._open):
            raise self._error(event, f"alias {quoted_text(f'*{event.anchor}')} contains itself")
        if event.anchor not in self._anchors:
            raise self._error(event, f"there is no anchor {quoted_text(f'&{event.anchor}')} before this alias")
        self._complete(*self._anchors[event.anchor], None)

    def _complete(self, value: Value, size: int, anchor: str | None) -> None:
        if anchor is not None:
            self._anchors[anchor] = (value, size)
        if not self._open:
            self.root = value
            return
        around = self._open[-1]
        around.children.append(value)
        around.size += size
        if around.size > MAX_VALUES:
            raise self._error(around.event, f"more than {MAX_VALUES} values, the most allowed in a file")

    def _error(self, event: yaml.Event, sentence: str) -> YamlError:
        return YamlError(Value(Kind.SCALAR, self._file, *_position(event)), sentence)


def _position(event: yaml.Event) -> tuple[int, int]:
    mark = event.start_mark
    return (mark.line + 1, mark.column + 1) if mark else (1, 1)
