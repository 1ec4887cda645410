"""Values of a net file with expressions: ``${...}`` alone keeps the type of the value; inside a text, text results."""

from collections.abc import Iterator
from functools import lru_cache

from im_core.errors import nearest
from im_core.yamltext import Location, quoted_text
from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.evaluation import Lookup, as_text, evaluate
from im_pnt.expression.inference import Meanings, infer
from im_pnt.expression.syntax import Binary, Call, Field, Item, Listing, Name, Node, Unary, parse
from im_pnt.expression.types import ANY, TEXT, ValueKind, ValueType

OPENS = "${"
"""Begins an expression."""


class PlacedError(ExpressionError):
    """Fault of a value, and the place.

    Args:
        location: Where, below the value that was looked at.
        sentence: What.
    """

    def __init__(self, location: Location, sentence: str) -> None:
        super().__init__(sentence)
        self.location, self.sentence = location, sentence


@lru_cache(maxsize=4096)
def pieces(text: str) -> tuple[str | Node, ...]:
    """Return the parts of a text: expressions, and the text between the expressions.

    Raises:
        ExpressionError: An expression is not closed, or is none.
    """
    found: list[str | Node] = []
    at = 0
    while (begin := text.find(OPENS, at)) >= 0:
        end, quoted = begin + 2, False
        while end < len(text) and (quoted or text[end] != "}"):
            quoted ^= text[end] == "'"
            end += 1
        if end == len(text):
            raise ExpressionError(f"'{text[begin : begin + 60]}' has no closing '}}'")
        if begin > at:
            found.append(text[at:begin])
        found.append(parse(text[begin + 2 : end]))
        at = end + 1
    return (*found, text[at:]) if at < len(text) else tuple(found)


def has_expressions(value: object) -> bool:
    """Whether there is an expression in a value."""
    if isinstance(value, dict):
        return any(map(has_expressions, value.values()))
    if isinstance(value, list | tuple):
        return any(map(has_expressions, value))
    return isinstance(value, str) and OPENS in value


def nodes(value: object) -> Iterator[Node]:
    """Yield the expressions in a value.

    Raises:
        ExpressionError: One cannot be read.
    """
    if isinstance(value, dict):
        for each in value.values():
            yield from nodes(each)
    elif isinstance(value, list | tuple):
        for each in value:
            yield from nodes(each)
    elif isinstance(value, str) and OPENS in value:
        yield from (piece for piece in pieces(value) if not isinstance(piece, str))


def references(node: Node) -> Iterator[tuple[str, ...]]:
    """Yield the names in an expression: the root and the known names after the root; no indices."""
    match node:
        case Field() | Item():
            path: list[str] = []
            of: Node = node
            while isinstance(of, Field | Item):
                if isinstance(of, Field):
                    path.insert(0, of.name)
                else:
                    yield from references(of.index)
                of = of.of
            if isinstance(of, Name):
                yield (of.root, *path)
            else:
                yield from references(of)
        case Unary(_, of):
            yield from references(of)
        case Binary(_, left, right):
            yield from references(left)
            yield from references(right)
        case Call(_, several) | Listing(several):
            for each in several:
                yield from references(each)


def filled(value: object, lookup: Lookup) -> object:
    """Return a value with the expressions evaluated.

    Raises:
        ExpressionError: One has no value.
    """
    if isinstance(value, dict):
        return {name: filled(each, lookup) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [filled(each, lookup) for each in value]
    if not isinstance(value, str) or OPENS not in value:
        return value
    parts = [piece if isinstance(piece, str) else evaluate(piece, lookup) for piece in pieces(value)]
    return parts[0] if len(parts) == 1 else "".join(map(as_text, parts))


def check_value(value: object, wanted: ValueType, meanings: Meanings, location: Location = ()) -> None:
    """Check a value against a wanted type, field by field.

    Args:
        value: Plain data, with expressions in it.
        wanted: The type.
        meanings: What names mean.
        location: Where the value stands.

    Raises:
        PlacedError: It does not fit; says where, and what is allowed.
    """
    if isinstance(value, str) and OPENS in value:
        _check_text(value, wanted, meanings, location)
    elif isinstance(value, dict):
        _check_fields(value, wanted, meanings, location)
    elif isinstance(value, list | tuple):
        if wanted.kind not in (ValueKind.LIST, ValueKind.ANY):
            raise PlacedError(location, f"a list is not {wanted}")
        limit = wanted.longest if wanted.longest is not None else len(value)
        if (wanted.length is not None and len(value) != wanted.length) or len(value) > limit:
            raise PlacedError(location, f"a list of {len(value)} is not {wanted}")
        for rank, each in enumerate(value):
            check_value(each, wanted.element or ANY, meanings, (*location, rank))
    elif not _is(value, wanted):
        raise PlacedError(location, f"{_shown(value)} is not {wanted}")


def _check_text(text: str, wanted: ValueType, meanings: Meanings, location: Location) -> None:
    try:
        parts = pieces(text)
        found = [TEXT if isinstance(part, str) else infer(part, meanings) for part in parts]
    except ExpressionError as error:
        raise PlacedError(location, str(error)) from error
    kind = found[0] if len(found) == 1 else TEXT
    if not kind.fits(wanted):
        raise PlacedError(location, f"{quoted_text(text)} is {kind}, not {wanted}")


def _check_fields(fields: dict[str, object], wanted: ValueType, meanings: Meanings, location: Location) -> None:
    known = meanings.types.fields(wanted.message) if wanted.kind is ValueKind.MESSAGE else None
    if wanted.kind not in (ValueKind.MESSAGE, ValueKind.ANY):
        raise PlacedError(location, f"a mapping is not {wanted}")
    for name, value in fields.items():
        if known is not None and name not in known:
            raise PlacedError((*location, name), f"{wanted.message} has no field '{name}'{nearest(name, known)}")
        check_value(value, ANY if known is None else known[name], meanings, (*location, name))


def _is(value: object, wanted: ValueType) -> bool:
    match wanted.kind:
        case ValueKind.ANY:
            return True
        case ValueKind.BOOLEAN:
            return isinstance(value, bool)
        case ValueKind.INTEGER:
            if isinstance(value, bool) or not isinstance(value, int):
                return False
            lowest, highest = wanted.lowest, wanted.highest
            return (lowest is None or value >= lowest) and (highest is None or value <= highest)
        case ValueKind.NUMBER:
            return isinstance(value, int | float) and not isinstance(value, bool)
        case ValueKind.TEXT:
            return isinstance(value, str) and (wanted.longest is None or len(value) <= wanted.longest)
        case _:
            return False


def _shown(value: object) -> str:
    return "nothing" if value is None else quoted_text(as_text(value))
