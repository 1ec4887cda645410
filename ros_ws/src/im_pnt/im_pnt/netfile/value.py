"""Values as they stand in a file, whatever its format."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum


class Kind(Enum):
    """What a value is."""

    SCALAR = "scalar"
    LIST = "list"
    MAPPING = "mapping"


@dataclass(frozen=True, slots=True)
class Value:
    """A value as it stands in a file.

    Attributes:
        kind: Scalar, list or mapping.
        text: Text of a scalar.
        quoted: Whether a scalar is text whatever it looks like.
        children: Elements of a list.
        pairs: Keys and values of a mapping, in the author's order; a key may be there twice.
        file: File it stands in.
        line: Line, from 1.
        column: Column, from 1.
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


def scalar(text: str, near: Value, *, quoted: bool = True) -> Value:
    """Makes a scalar that stands where another value stands."""
    return Value(Kind.SCALAR, near.file, near.line, near.column, text=text, quoted=quoted, note=near.note)


def sequence(children: Iterable[Value], near: Value) -> Value:
    """Makes a list that stands where another value stands."""
    return Value(Kind.LIST, near.file, near.line, near.column, children=tuple(children), note=near.note)


def mapping(pairs: Iterable[tuple[Value, Value]], near: Value) -> Value:
    """Makes a mapping that stands where another value stands."""
    return Value(Kind.MAPPING, near.file, near.line, near.column, pairs=tuple(pairs), note=near.note)


def noted(value: Value, note: str) -> Value:
    """Returns a value whose complaints say something more."""
    return replace(value, note=note)
