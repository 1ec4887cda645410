"""Templates: parts of a net that are written once and used many times."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product

from im_pnt.errors import nearest
from im_pnt.netfile import keys
from im_pnt.netfile.expression import ExpressionError, Parameter, evaluate, substitute
from im_pnt.netfile.names import checked, checked_key
from im_pnt.netfile.node import Node
from im_pnt.netfile.value import Kind, Value, noted

MAX_COPIES = 10_000
_RANGE = re.compile(r"(-?[0-9]{1,9})\.\.(-?[0-9]{1,9})")


@dataclass(frozen=True, slots=True)
class Template:
    """A part of a net with parameters.

    Attributes:
        name: Its name.
        parameters: What a use must give.
        sections: Its places, services, rest and transitions.
        node: Where it is written.
    """

    name: str
    parameters: tuple[str, ...]
    sections: Mapping[str, Node]
    node: Node


def read_template(name: str, node: Node) -> Template:
    """Reads a template.

    Raises:
        NetFileError: It is none.
    """
    entries = node.items(keys.TEMPLATE)
    parameters: list[str] = []
    for element in entries["parameters"].elements() if "parameters" in entries else ():
        parameter = checked(element)
        if parameter in parameters or parameter == "mod":
            raise element.error(f"'{parameter}' cannot be a parameter here: it is there twice, or an operator")
        parameters.append(parameter)
    sections = {key: entry for key, entry in entries.items() if key != "parameters"}
    return Template(checked_key(node, name), tuple(parameters), sections, node)


def copies(use: Node, templates: Mapping[str, Template]) -> Iterator[dict[str, Node]]:
    """Makes the copies that an entry of ``use`` asks for.

    Args:
        use: The entry.
        templates: Templates by name.

    Yields:
        For each copy its sections.

    Raises:
        NetFileError: No such template, a parameter without value, or an expression that cannot be evaluated.
    """
    entries = use.items(keys.USE)
    if "template" not in entries:
        raise use.error("'template' is missing")
    name = entries["template"].text()
    if name not in templates:
        raise entries["template"].error(f"there is no template '{name}'{nearest(name, templates)}")
    template = templates[name]
    ranges = {key: _range(checked_key(node, key), node) for key, node in _items(entries, "for")}
    given = dict(_items(entries, "with"))
    for key, node in given.items():
        if key not in template.parameters:
            raise node.key_error(f"template {name} has no parameter '{key}'{nearest(key, template.parameters)}")
    for parameter in template.parameters:
        if parameter not in ranges and parameter not in given:
            raise use.error(f"template {name} needs a value for its parameter '{parameter}'")
    count = 1
    for values in ranges.values():
        count *= len(values)
    if count > MAX_COPIES:
        raise use.error(f"asks for {count} copies; {MAX_COPIES} are allowed")
    for combination in product(*ranges.values()):
        running: dict[str, Parameter] = dict(zip(ranges, combination, strict=True))
        bound = running | {key: _given(node, running) for key, node in given.items()}
        shown = ", ".join(f"{key}={bound[key]}" for key in template.parameters)
        by = f" with {shown}" if shown else ""
        note = f" (template {name}{by}, used in {use.file}:{use.value.line}:{use.value.column})"
        sections = template.sections.items()
        yield {key: replace(node, value=_filled(node, node.value, bound, note)) for key, node in sections}


def _items(entries: Mapping[str, Node], key: str) -> Iterator[tuple[str, Node]]:
    if key in entries:
        yield from entries[key].items().items()


def _range(name: str, node: Node) -> list[Parameter]:
    """Reads ``0..4`` or a list of numbers and texts."""
    if node.is_scalar:
        match = _RANGE.fullmatch(node.text().strip())
        if not match:
            raise node.error(f"{node.shown()} is neither a range like 0..4 nor a list of values for {name}")
        first, last = int(match.group(1)), int(match.group(2))
        if last - first >= MAX_COPIES:
            raise node.error(f"{node.shown()} has more than {MAX_COPIES} values")
        if last < first:
            raise node.error(f"{node.shown()} is empty: it ends before it begins")
        return list(range(first, last + 1))
    return [_parameter(element) for element in node.elements()]


def _parameter(node: Node) -> Parameter:
    value = node.plain() if node.is_scalar else None
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) <= 10**9:
        return value
    return node.text()


def _given(node: Node, running: Mapping[str, Parameter]) -> Parameter:
    text = node.value.text
    if not node.is_scalar or "$(" not in text:
        return _parameter(node)
    try:
        whole = text.startswith("$(") and text.endswith(")") and text.count("$(") == 1
        return evaluate(text[2:-1], running) if whole else substitute(text, running)
    except ExpressionError as error:
        raise node.error(str(error)) from error


def _filled(section: Node, value: Value, bound: Mapping[str, Parameter], note: str) -> Value:
    """Copies a value with its expressions replaced; as deep as the file nests."""
    if value.kind is Kind.SCALAR:
        if "$(" not in value.text:
            return noted(value, note)
        try:
            return replace(value, text=substitute(value.text, bound), note=note)
        except ExpressionError as error:
            raise Node(noted(value, note), section.path).error(str(error)) from error
    if value.kind is Kind.LIST:
        return replace(value, children=tuple(_filled(section, v, bound, note) for v in value.children), note=note)
    pairs = tuple((_filled(section, k, bound, note), _filled(section, v, bound, note)) for k, v in value.pairs)
    return replace(value, pairs=pairs, note=note)
