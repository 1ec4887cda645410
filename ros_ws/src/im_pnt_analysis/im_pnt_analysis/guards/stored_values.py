"""Knowledge of the data objects of a net: bounds of counters, and facts as of the last stored value."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache

from im_core.errors import ImError
from im_pnt.expression.inference import Meanings, infer
from im_pnt.expression.syntax import Binary, Field, Literal, Name, Node, rebuilt, shown
from im_pnt.expression.template import OPENS, Way, has_expressions, nodes, pieces, references
from im_pnt.expression.types import ANY, ValueKind, ValueType
from im_pnt.model.net import Guard, Net, Transition

Bounds = Mapping[Way, tuple[float | None, float | None]]
"""Least and greatest values of fields of data objects, by name and way to the field; None: not known."""

_EXACT = (ValueKind.INTEGER, ValueKind.TEXT, ValueKind.BOOLEAN)
"""Kinds whose values a message keeps as they are computed."""


def stored_bounds(net: Net, name: str) -> Bounds:
    """Return the bounds of the numbers in a data object, such as a counter, from all values stored by a net."""
    stored = [dict(_fields(t.store[name])) for t in net.transitions.values() if name in t.store]
    found: dict[Way, tuple[float | None, float | None]] = {}
    for way in {way for each in stored for way in each}:
        path = (name, *way)
        changes = [_change(each.get(way, 0), path) for each in stored]
        values = [value for value, step in changes if value is not None and step is None]
        steps = [step for value, step in changes if value is None]
        if values and None not in steps:
            low = min(values) if all(step is not None and step >= 0 for step in steps) else None
            high = max(values) if all(step is not None and step <= 0 for step in steps) else None
            found[path] = (low, high)
    return found


def facts_when_stored(
    facts: frozenset[Guard], transition: Transition, stable: frozenset[str], meanings: Meanings
) -> frozenset[Guard]:
    """Return the facts about values that a transition has stored.

    That is the value itself, ``n == 0``; and where ``n + 1`` was stored, each fact of before about one less:
    ``n < 3`` has become ``n - 1 < 3``. A fact is carried over one step, not over two, so that loops come to an end.

    Args:
        facts: Known when the transition fires.
        transition: Whose values are stored.
        stable: Data objects of the command that the net alone stores.
        meanings: Types of names at the transition.
    """
    found = set[Guard]()
    new = frozenset(transition.store)
    for name in sorted(new & stable):
        for way, value in _fields(transition.store[name]):
            of = _field(("data", name, *way))
            kind = type_of(of, meanings).kind
            if kind not in _EXACT:
                continue
            _, step = _change(value, (name, *way))
            if isinstance(step, int) and kind is ValueKind.INTEGER:
                found.update(_carried(facts, of, step, new))
            elif (written := _written(value)) is not None and _stays(written, transition, stable - new):
                found.update(_as_guard(Binary("==", of, written)) if type_of(written, meanings).kind is kind else ())
    return frozenset(found)


def _carried(facts: frozenset[Guard], of: Node, step: int, new: frozenset[str]) -> Iterator[Guard]:
    """Yield the facts about a number as facts about the number after a step."""
    before = Binary("-", of, Literal(step))
    for fact in facts:
        changed = {path for path in named(fact) if path[0] == "data" and path[1] in new}
        if changed == set(references(of)):
            yield from _with(fact, of, before)


def _with(fact: Guard, of: Node, before: Node) -> tuple[Guard, ...]:
    """Return a guard with the value before a step in the place of a value; nothing for a guard about such a value."""

    def change(node: Node) -> Node:
        return before if node == of else rebuilt(node, change)

    if fact.unless:
        unless = tuple(new for each in fact.unless for new in _with(each, of, before))
        return (replace(fact, unless=unless),) if len(unless) == len(fact.unless) else ()
    (node,) = nodes(fact.name)
    carried = f"({shown(of)} - " in shown(node)
    return () if carried else tuple(replace(each, negated=fact.negated) for each in _as_guard(change(node)))


def _as_guard(node: Node) -> tuple[Guard, ...]:
    """Return an expression as a guard; nothing where the text would be too long or too deep."""
    text = f"{OPENS}{shown(node)}}}"
    try:
        pieces(text)
    except ImError:
        return ()
    return (Guard(text),)


def _stays(value: Node, transition: Transition, stable: frozenset[str]) -> bool:
    """Return whether a stored value stays the same until a transition gives a new one."""
    own = (transition.name, transition.retry_of)
    return all(
        root == "arguments" or (root == "data" and name in stable) or (root == "answers" and name not in own)
        for root, name, *_ in references(value)
    )


@lru_cache(maxsize=4096)
def named(guard: Guard) -> frozenset[Way]:
    """Return the names in the expressions of a guard: roots, and what follows."""
    return frozenset(path for each in (guard, *guard.unless) for node in nodes(each.name) for path in references(node))


def type_of(node: Node, meanings: Meanings) -> ValueType:
    """Return the type of an expression, any where none can be told."""
    try:
        return infer(node, meanings)
    except ImError:
        return ANY


def _field(path: Way) -> Node:
    node: Node = Name(path[0])
    for name in path[1:]:
        node = Field(node, name)
    return node


def _fields(value: object, way: Way = ()) -> Iterator[tuple[Way, object]]:
    """Yield the fields of a stored message, with the ways to them."""
    if isinstance(value, Mapping):
        for name, each in value.items():
            yield from _fields(each, (*way, str(name)))
    else:
        yield way, value


def _written(value: object) -> Node | None:
    """Return a stored value as an expression; None for another text."""
    if isinstance(value, str) and has_expressions(value):
        parts = pieces(value)
        return parts[0] if len(parts) == 1 and not isinstance(parts[0], str) else None
    return Literal(value) if isinstance(value, bool | int | float | str) and "'" not in str(value) else None


def _change(value: object, path: Way) -> tuple[float | None, float | None]:
    """Return the stored number, or the step added to the number before; None: not told."""
    match _written(value):
        case Literal(int() | float() as number) if not isinstance(number, bool):
            return number, None
        case Binary("+" | "-" as sign, of, Literal(int() | float() as step)) if of == _field(("data", *path)):
            return None, step if sign == "+" else -step
    return None, None
