"""Values of a net file with expressions: ``${...}`` alone keeps the type of the value; inside a text, text results."""

from collections.abc import Iterator
from functools import lru_cache

from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.evaluation import Lookup, as_text, evaluate
from im_pnt.expression.syntax import Binary, Call, Field, Item, Listing, Name, Node, Unary, parse
from im_pnt.model.net import Net

OPENS = "${"
"""Begins an expression."""

Way = tuple[str, ...]
"""Names that lead to a field, through lists too."""


@lru_cache(maxsize=4096)
def pieces(text: str) -> tuple[str | Node, ...]:
    """Return the parts of a text: expressions, and the text between the expressions.

    Raises:
        ExpressionError: An expression is not closed, or is none.
    """
    return tuple(parse(part[2:-1]) if part.startswith(OPENS) else part for part in written_pieces(text))


def written_pieces(text: str) -> list[str]:
    """Return the parts of a text as written: expressions ``${...}``, and the text between the expressions.

    Raises:
        ExpressionError: An expression is not closed.
    """
    found: list[str] = []
    at = 0
    while (begin := text.find(OPENS, at)) >= 0:
        end, quoted = begin + 2, False
        while end < len(text) and (quoted or text[end] != "}"):
            quoted ^= text[end] == "'"
            end += 1
        if end == len(text):
            raise ExpressionError(f"'{text[begin : begin + 60]}' has no closing '}}'")
        found += [text[at:begin], text[begin : end + 1]] if begin > at else [text[begin : end + 1]]
        at = end + 1
    return [*found, text[at:]] if at < len(text) else found


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


def read_answers(net: Net) -> dict[str, tuple[Way, ...]]:
    """Return the needed fields of answers, by transition: ways to fields, none within another."""
    values: list[object] = []
    for transition in net.transitions.values():
        guard = transition.guard.name if transition.guard is not None else ""
        until = getattr(transition.action, "until", None) or ""
        values += [getattr(transition.action, "fields", {}), until, guard, transition.says]
        values += [transition.result, transition.store]
    return _ways(values, "answers")


def read_objects(value: object) -> dict[str, tuple[Way, ...]]:
    """Return the needed fields of data objects in expressions of a value, by object."""
    return _ways(value, "data")


def _ways(value: object, root: str) -> dict[str, tuple[Way, ...]]:
    ways: dict[str, set[Way]] = {}
    for node in nodes(value):
        for path in references(node):
            if path[0] == root:
                ways.setdefault(path[1], set()).add(path[2:])
    return {name: tuple(sorted(way for way in found if not _covered(way, found))) for name, found in ways.items()}


def _covered(way: Way, others: set[Way]) -> bool:
    return any(way[:count] in others for count in range(len(way)))
