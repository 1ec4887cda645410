"""Templates of net files: ``$(...)`` in them becomes the value of a parameter."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from im_core.errors import nearest
from im_core.text.yamltext import Kind, Location, Value, mapping, scalar, sequence
from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.evaluation import as_text, evaluate
from im_pnt.expression.syntax import parse
from im_pnt.netfile.schema.scalars import Written
from im_pnt.netfile.schema.templates import Parameter, TemplateFile
from im_pnt.netfile.text import complaint


@dataclass(frozen=True, slots=True)
class Template:
    """Template and the file."""

    file: TemplateFile
    root: Value
    location: Location
    given: Mapping[str, Parameter]


def is_whole(text: str) -> bool:
    """Return whether a text is one ``$(...)`` and nothing beside it."""
    return text.startswith("$(") and text.endswith(")") and text.count("$(") == 1


def substitute(text: str, values: Mapping[str, Parameter]) -> str:
    """Replace every ``$(...)`` of a text by the value.

    Raises:
        ExpressionError: One is not closed, or has no value.
    """
    done: list[str] = []
    at = 0
    while (begin := text.find("$(", at)) >= 0:
        end, depth = begin + 2, 1
        while depth and end < len(text):
            depth += {"(": 1, ")": -1}.get(text[end], 0)
            end += 1
        if depth:
            raise ExpressionError(f"'{text[begin : begin + 40]}' has no closing parenthesis")
        found = evaluated(text[begin + 2 : end - 1], values)
        if not isinstance(found, int | str):
            raise ExpressionError(
                f"'{text[begin + 2 : end - 1]}' is {as_text(found)}, neither a whole number nor a text"
            )
        done += [text[at:begin], str(found)]
        at = end
    return "".join([*done, text[at:]])


def evaluated(text: str, values: Mapping[str, Parameter]) -> Parameter:
    """Return the value of an expression with parameters as the only names: a number, a text, a list or a mapping.

    Raises:
        ExpressionError: It has none.
    """

    def parameter(name: str, field: str) -> object:
        value = values[name]
        if not field:
            return value
        if not isinstance(value, dict) or field not in value:
            hint = nearest(field, value) if isinstance(value, dict) else ""
            raise ExpressionError(f"parameter {name} has no field '{field}'{hint}")
        return value[field]

    found = evaluate(parse(text, tuple(values)), parameter)
    if isinstance(found, bool) or not isinstance(found, int | float | str | list | dict):
        raise ExpressionError(f"'{text}' is {as_text(found)}, neither a number, a text, a list nor a mapping")
    return found


def filled(location: Location, value: Value, bound: Mapping[str, Parameter], note: str) -> Value:
    """Copy a value with the expressions evaluated, as deep as the file nests; ``[zone, $(cameras)]`` is one list."""
    if value.kind is Kind.SCALAR:
        if "$(" not in value.text:
            return replace(value, note=note)
        try:
            if is_whole(value.text):
                return _written(evaluated(value.text[2:-1], bound), replace(value, note=note))
            return replace(value, text=substitute(value.text, bound), note=note)
        except ExpressionError as error:
            raise complaint(replace(value, note=note), str(error), location) from error
    if value.kind is Kind.LIST:
        return replace(value, children=tuple(_entries(location, value, bound, note)), note=note)
    pairs = tuple((filled(location, k, bound, note), filled(location, v, bound, note)) for k, v in value.pairs)
    return replace(value, pairs=pairs, note=note)


def _written(found: object, near: Value) -> Value:
    """Return a value as it would be written in the file, with its type."""
    if isinstance(found, list):
        return sequence((_written(each, near) for each in found), near)
    if isinstance(found, dict):
        return mapping(((scalar(name, near), _written(each, near)) for name, each in found.items()), near)
    return scalar(str(found), near, quoted=isinstance(found, str) and not isinstance(found, Written))


def _entries(location: Location, value: Value, bound: Mapping[str, Parameter], note: str) -> Iterator[Value]:
    for child in value.children:
        one = filled(location, child, bound, note)
        added = child.kind is Kind.SCALAR and one.kind is Kind.LIST
        yield from one.children if added else (one,)


def size(value: Value) -> int:
    """Count the values in a value."""
    if value.kind is Kind.SCALAR:
        return 1
    return 1 + sum(map(size, value.children)) + sum(1 + size(child) for _, child in value.pairs)
