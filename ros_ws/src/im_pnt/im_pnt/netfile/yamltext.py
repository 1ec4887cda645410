"""YAML text to values, in bounded time and memory whatever the text is.

The parser's events are put together here instead of by the library, whose own composer recurses as deep as the text
nests, and lets a few aliases stand for billions of values.
"""

from dataclasses import dataclass, field

import yaml

from im_pnt.errors import NetFileError
from im_pnt.netfile.value import Kind, Value

MAX_DEPTH = 40
MAX_VALUES = 500_000
_STRING_TAGS = frozenset({None, "!", "tag:yaml.org,2002:str"})
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(slots=True)
class _Open:
    """A list or mapping whose end has not come yet."""

    event: yaml.NodeEvent
    children: list[Value] = field(default_factory=list)
    size: int = 1


def read_yaml(text: str, file: str) -> Value:
    """Parses one YAML document.

    Args:
        text: The document.
        file: Its name in messages.

    Raises:
        NetFileError: Not YAML, empty, more than one document, tags, aliases that contain themselves, or more values or
            deeper nesting than a net can need.
    """
    composer = _Composer(file)
    try:
        for event in yaml.parse(text, Loader=_LOADER):
            composer.take(event)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line, column = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        raise NetFileError(file, line, f"not YAML: {error.problem or error.context}", column) from error
    except (yaml.YAMLError, UnicodeError) as error:
        raise NetFileError(file, 1, f"not YAML: {' '.join(str(error).split())}", 1) from error
    if composer.root is None:
        raise NetFileError(file, 1, "the file is empty", 1)
    return composer.root


class _Composer:
    def __init__(self, file: str) -> None:
        self.root: Value | None = None
        self._file = file
        self._open: list[_Open] = []
        self._anchors: dict[str, tuple[Value, int]] = {}
        self._documents = 0

    def take(self, event: yaml.Event) -> None:
        match event:
            case yaml.DocumentStartEvent():
                self._documents += 1
                if self._documents > 1:
                    raise self._error(event, "a second document begins; one net a file is allowed")
            case yaml.AliasEvent():
                self._alias(event)
            case yaml.ScalarEvent():
                if event.tag not in _STRING_TAGS:
                    raise self._error(event, f"tag '{event.tag}' is not allowed")
                quoted = event.style in ("'", '"', "|", ">") or event.tag is not None
                self._done(self._value(event, Kind.SCALAR, text=event.value, quoted=quoted), 1, event.anchor)
            case yaml.SequenceStartEvent() | yaml.MappingStartEvent():
                if event.tag not in (None, "!"):
                    raise self._error(event, f"tag '{event.tag}' is not allowed")
                if len(self._open) >= MAX_DEPTH:
                    raise self._error(event, f"values nest deeper than {MAX_DEPTH}")
                self._open.append(_Open(event))
            case yaml.SequenceEndEvent() | yaml.MappingEndEvent():
                self._close()

    def _close(self) -> None:
        ended = self._open.pop()
        children = ended.children
        if isinstance(ended.event, yaml.SequenceStartEvent):
            value = self._value(ended.event, Kind.LIST, children=tuple(children))
        else:
            pairs = tuple(zip(children[::2], children[1::2], strict=True))
            value = self._value(ended.event, Kind.MAPPING, pairs=pairs)
        self._done(value, ended.size, ended.event.anchor)

    def _alias(self, event: yaml.AliasEvent) -> None:
        if any(event.anchor == each.event.anchor for each in self._open):
            raise self._error(event, f"alias '*{event.anchor}' contains itself")
        if event.anchor not in self._anchors:
            raise self._error(event, f"there is no anchor '&{event.anchor}' before this alias")
        self._done(*self._anchors[event.anchor], None)

    def _done(self, value: Value, size: int, anchor: str | None) -> None:
        if anchor is not None:
            self._anchors[anchor] = (value, size)
        if not self._open:
            self.root = value
            return
        around = self._open[-1]
        around.children.append(value)
        around.size += size
        if around.size > MAX_VALUES:
            raise self._error(around.event, f"more than {MAX_VALUES} values; a net file may not have as many")

    def _value(
        self,
        event: yaml.Event,
        kind: Kind,
        *,
        text: str = "",
        quoted: bool = False,
        children: tuple[Value, ...] = (),
        pairs: tuple[tuple[Value, Value], ...] = (),
    ) -> Value:
        return Value(kind, self._file, *_position(event), text, quoted, children, pairs)

    def _error(self, event: yaml.Event, message: str) -> NetFileError:
        line, column = _position(event)
        return NetFileError(self._file, line, message, column)


def _position(event: yaml.Event) -> tuple[int, int]:
    mark = event.start_mark
    return (mark.line + 1, mark.column + 1) if mark else (1, 1)
