"""Values of a file that remember where they stand, so that every complaint can name file, line and column."""

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from im_pnt.errors import NetFileError, nearest
from im_pnt.netfile.value import Kind, Value

LARGEST = 2**31 - 1
"""Largest number of tokens, weight or priority: analysis packs markings."""

_NULL = frozenset({"", "~", "null", "Null", "NULL"})
_BOOLEAN = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]{0,19})")
_FLOAT = re.compile(r"[-+]?((0|[1-9][0-9]*)(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]{1,5})?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_SHOWN = 60


@dataclass(frozen=True, slots=True)
class Node:
    """A value with the way that leads to it.

    Attributes:
        value: The value.
        path: Keys from the root, for messages.
        key: Key of the mapping that it belongs to.
    """

    value: Value
    path: str = ""
    key: Value | None = None

    @property
    def _place(self) -> Value:
        """Where a complaint points: at a scalar itself, at the key of anything larger."""
        written = self.value.kind is Kind.SCALAR and not self.is_null
        return self.value if written or self.key is None else self.key

    @property
    def line(self) -> int:
        """Line of the key, or of the value where it has none."""
        return (self.key or self.value).line

    @property
    def file(self) -> str:
        """File it stands in."""
        return self.value.file

    def error(self, message: str) -> NetFileError:
        """Makes the error that names this value's file, line and column."""
        return _error(self._place, self.path, message)

    def key_error(self, message: str) -> NetFileError:
        """Makes the error that points at the key instead of the value."""
        return _error(self.key or self.value, self.path, message)

    @property
    def is_null(self) -> bool:
        """Whether nothing is written here."""
        value = self.value
        return value.kind is Kind.SCALAR and not value.quoted and value.text in _NULL

    @property
    def is_mapping(self) -> bool:
        """Whether this is a mapping."""
        return self.value.kind is Kind.MAPPING

    @property
    def is_scalar(self) -> bool:
        """Whether this is a single value."""
        return self.value.kind is Kind.SCALAR

    def items(self, known: Iterable[str] | None = None) -> dict[str, "Node"]:
        """Returns the entries of a mapping.

        Args:
            known: Keys that are allowed; None: any.

        Raises:
            NetFileError: Not a mapping, a key twice, or a key that is not known.
        """
        if self.is_null:
            return {}
        if not self.is_mapping:
            raise self.error(f"{self.shown()} is not a mapping (key: value)")
        allowed = None if known is None else set(known)
        entries: dict[str, Node] = {}
        for key, value in self.value.pairs:
            name = Node(key, self.path).text()
            entry = Node(value, f"{self.path}.{name}" if self.path else name, key)
            if name in entries:
                raise _error(key, self.path, f"'{name}' is there twice; the first is in {entries[name]._seen(key)}")
            if allowed is not None and name not in allowed:
                raise _error(key, self.path, f"'{name}' is not a known key{nearest(name, allowed)}")
            entries[name] = entry
        return entries

    def elements(self) -> Iterator["Node"]:
        """Iterates over a list; a single value counts as a list of one.

        Raises:
            NetFileError: A mapping.
        """
        if self.is_null:
            return
        if self.is_mapping:
            raise self.error(f"{self.shown()} is not a list")
        if self.is_scalar:
            yield self
        for index, child in enumerate(self.value.children):
            yield Node(child, f"{self.path}[{index}]")

    def text(self) -> str:
        """Returns a scalar as text.

        Raises:
            NetFileError: Not a scalar, nothing, or text with control characters.
        """
        if not self.is_scalar or self.is_null:
            raise self.error(f"{self.shown()} is not a text")
        for character in self.value.text:
            if (character < " " and character not in "\t\n") or "\x7f" <= character <= "\x9f" or _unwritable(character):
                raise self.error(f"control character U+{ord(character):04X} is not allowed in a text")
        return self.value.text

    def integer(self, minimum: int, maximum: int = LARGEST) -> int:
        """Returns a whole number.

        Raises:
            NetFileError: Not a whole number, or outside the limits.
        """
        value = self.plain() if self.is_scalar else None
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(f"{self.shown()} is not a whole number")
        if value < minimum:
            raise self.error(f"{value} is not >= {minimum}")
        if value > maximum:
            raise self.error(f"{value} is not <= {maximum}")
        return value

    def number(self, lowest: float, *, above: bool = False, highest: float = math.inf) -> float:
        """Returns a finite number.

        Args:
            lowest: Least value.
            above: Whether it must be greater than the least.
            highest: Largest value.

        Raises:
            NetFileError: Not a number, or outside the limits.
        """
        value = self.plain() if self.is_scalar else None
        if not isinstance(value, bool) and isinstance(value, int | float):
            number = float(value)
            if (number > lowest or (number == lowest and not above)) and number <= highest:
                return number
        least = "" if lowest == -math.inf else f" {'>' if above else '>='} {lowest:g}"
        most = "" if highest == math.inf else f" and <= {highest:g}"
        raise self.error(f"{self.shown()} is not a number{least}{most}")

    def boolean(self) -> bool:
        """Returns true or false.

        Raises:
            NetFileError: Neither.
        """
        value = self.plain() if self.is_scalar else None
        if not isinstance(value, bool):
            raise self.error(f"{self.shown()} is neither true nor false")
        return value

    def plain(self) -> object:
        """Returns the value as plain Python; unquoted words are read as YAML 1.2 does: ``on`` and ``yes`` are texts.

        Raises:
            NetFileError: A key twice, or a number that is not finite or has more than 20 digits.
        """
        if self.is_mapping:
            return {name: child.plain() for name, child in self.items().items()}
        if not self.is_scalar:
            return [child.plain() for child in self.elements()]
        text = self.value.text
        if self.value.quoted:
            return text
        if text in _NULL:
            return None
        if text in _BOOLEAN:
            return _BOOLEAN[text]
        if _INTEGER.fullmatch(text):
            return int(text)
        if _FLOAT.fullmatch(text) or _NOT_FINITE.fullmatch(text):
            if _NOT_FINITE.fullmatch(text) or not math.isfinite(float(text)) or text.lstrip("-+").isdigit():
                raise self.error(f"{self.shown()} is not a finite number of at most 20 digits")
            return float(text)
        return text

    def shown(self) -> str:
        """Returns a short form of the value for messages."""
        if not self.is_scalar:
            return "a mapping" if self.is_mapping else "a list"
        text = self.value.text
        return "nothing" if self.is_null else repr(text if len(text) <= _SHOWN else text[:_SHOWN] + "...")

    def _seen(self, other: Value) -> str:
        mine = self.key or self.value
        where = f"line {mine.line}" if mine.file == other.file else f"{mine.file}:{mine.line}"
        return where + (mine.note if mine.note != other.note else "")


def _unwritable(character: str) -> bool:
    """Whether no XML file can hold it."""
    return "\ud800" <= character <= "\udfff" or character in "\ufffe\uffff"


def _error(place: Value, path: str, message: str) -> NetFileError:
    where = f"{path}: " if path else ""
    return NetFileError(place.file, place.line, f"{where}{message}{place.note}", place.column)
