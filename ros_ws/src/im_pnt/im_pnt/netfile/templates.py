"""Assembly of a net file: included files read, templates copied in the places."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

from im_core.errors import DataError, nearest, quoted_text
from im_core.message_paths import resolve_below
from im_core.text.yamltext import MAX_VALUES, Kind, Location, Value, find, mapping, scalar, sequence
from im_pnt.errors import NetFileError
from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.evaluation import as_text, evaluate
from im_pnt.expression.syntax import parse
from im_pnt.netfile.schema.net import FragmentFile
from im_pnt.netfile.schema.scalars import Written
from im_pnt.netfile.schema.templates import Parameter, TemplateFile, UseFile
from im_pnt.netfile.text import checked, complaint, complaint_at, read_data, read_text, read_values

MAX_COPIES = 10_000
_COUNTED = 10**30
MAX_INCLUDES = 8
MAX_FILES = 100
_MAPPINGS = ("places", "services", "commands", "transitions")
_SECTIONS = (*_MAPPINGS, "rest")


def assemble(root: Value, file: Path | None, within: Sequence[Path] = ()) -> Value:
    """Read the included files of a net file, and copy the used templates.

    Args:
        root: The file as written.
        file: Where it is; None: nowhere, and it can include nothing.
        within: Folders that included files lie below; empty: they may lie anywhere.

    Returns:
        The same net without ``include``, ``templates`` and ``use``.

    Raises:
        NetFileError: A file that cannot be included, includes that go round, or a template that cannot be used.
    """
    fragment = FragmentFile.model_fields.keys()
    if not {key.text for key, _ in root.pairs} & {"include", "templates", "use"}:
        return root
    assembly = _Assembly(within)
    own = {key: value for key, value in read_data(root).items() if key in fragment}
    assembly.add(root, own, () if file is None else (file,))
    assembly.copy()
    pairs = [(key, value) for key, value in root.pairs if key.text not in fragment]
    for name, section in assembly.sections.items():
        near = next((key for key, _ in root.pairs if key.text == name), root)
        pairs.append((scalar(name, near), mapping(section, near)))
    if assembly.rest is not None:
        near = next((key for key, _ in root.pairs if key.text == "rest"), root)
        pairs.append((scalar("rest", near), sequence(assembly.rest, near)))
    return mapping(pairs, root)


@dataclass(frozen=True, slots=True)
class _Template:
    """Template and the file."""

    file: TemplateFile
    root: Value
    location: Location


class _Assembly:
    """Sections of all files and copies."""

    def __init__(self, within: Sequence[Path]) -> None:
        self._within = within
        self.sections: dict[str, list[tuple[Value, Value]]] = {}
        self.rest: list[Value] | None = None
        self._templates: dict[str, _Template] = {}
        self._uses: list[tuple[Value, Location, UseFile]] = []
        self._read: set[Path] = set()
        self._values = 0

    def add(self, root: Value, data: Mapping[str, object], chain: tuple[Path, ...]) -> None:
        """Add a file, after the included ones."""
        fragment = checked(root, data, FragmentFile, FragmentFile.model_validate)
        for rank, name in enumerate(fragment.include):
            self._include(root, ("include", rank), name, chain)
        for name, template in fragment.templates.items():
            location = ("templates", name)
            if name in self._templates:
                other = self._templates[name]
                first = find(other.root, other.location)
                line = (first.key or first.value).line
                sentence = f"template {quoted_text(name)} is there twice; the first is in {other.root.file}:{line}"
                raise complaint_at(root, location, sentence, key=True)
            self._templates[name] = _Template(template, root, location)
        self._uses += [(root, ("use", rank), use) for rank, use in enumerate(fragment.use)]
        self._add_sections({key.text: value for key, value in root.pairs if key.text in _SECTIONS}, root, ())

    def copy(self) -> None:
        """Make the copies of templates, all templates being known now."""
        for root, location, use in self._uses:
            if use.template not in self._templates:
                sentence = f"there is no template {quoted_text(use.template)}{nearest(use.template, self._templates)}"
                raise complaint_at(root, (*location, "template"), sentence)
            template = self._templates[use.template]
            for sections in _copies(root, location, use, template):
                self._add_sections(sections, template.root, template.location)
                self._values += sum(_size(value) for value in sections.values())
                if self._values > MAX_VALUES:
                    sentence = f"the copies of templates make more than {MAX_VALUES} values"
                    raise complaint_at(root, location, sentence)

    def _add_sections(self, sections: Mapping[str, Value], root: Value, location: Location) -> None:
        for name, value in sections.items():
            if name == "rest":
                if value.kind is Kind.MAPPING:
                    raise complaint_at(root, (*location, name), "a mapping is not a list")
                children = value.children if value.kind is Kind.LIST else () if value.is_null else (value,)
                self.rest = [*(self.rest or []), *children]
                continue
            section = self.sections.setdefault(name, [])
            if value.kind is not Kind.MAPPING and not value.is_null:
                raise complaint_at(root, (*location, name), f"{value.shown()} is not a mapping (key: value)")
            section.extend(value.pairs)

    def _include(self, root: Value, location: Location, name: str, chain: tuple[Path, ...]) -> None:
        if not chain:
            sentence = f"{quoted_text(name)} cannot be included: this net is a text without a file"
            raise complaint_at(root, location, sentence)
        path = chain[-1].parent / name
        if self._within:
            try:
                resolve_below(str(path), self._within, "include")
            except DataError as error:
                raise complaint_at(root, location, error.message) from error
        # else resolve raises; reading names the fault
        real = path.resolve() if "\0" not in name and not _loops(path) else path
        way = [each.resolve() for each in chain]
        if real in way:
            names = " -> ".join(str(each) for each in [*chain[way.index(real) :], path])
            raise complaint_at(root, location, f"includes go round: {names}")
        if len(chain) > MAX_INCLUDES:
            names = " -> ".join(str(each) for each in [*chain, path])
            raise complaint_at(root, location, f"includes are deeper than {MAX_INCLUDES}: {names}")
        if real in self._read:  # two files may include a third
            return
        self._read.add(real)
        if len(self._read) > MAX_FILES:
            raise complaint_at(root, location, f"more than {MAX_FILES} files are included")
        try:
            text = read_text(path, self._within)
        except NetFileError as error:
            raise complaint_at(root, location, f"cannot be included: {error.message}") from error
        included = read_values(text, str(path))
        data = read_data(included)
        if "net" in data:
            by = find(root, location).value
            sentence = (
                f"a file that is included (by {root.file}:{by.line}) is no net of its own; "
                f"it may have {', '.join(FragmentFile.model_fields)}"
            )
            raise complaint_at(included, ("net",), sentence, key=True)
        self.add(included, data, (*chain, path))


def _copies(root: Value, location: Location, use: UseFile, template: _Template) -> Iterator[dict[str, Value]]:
    """Make the copies for an entry of ``use``: the sections of each."""
    name, parameters = use.template, dict.fromkeys(template.file.parameters)
    for key in use.given:
        if key not in parameters:
            sentence = f"template {name} has no parameter {quoted_text(key)}{nearest(key, parameters)}"
            raise complaint_at(root, (*location, "with", key), sentence, key=True)
    for parameter in parameters:
        if parameter not in use.ranges and parameter not in use.given:
            raise complaint_at(root, location, f"template {name} needs a value for its parameter '{parameter}'")
    count = 1
    for values in use.ranges.values():
        count = min(count * len(values), _COUNTED)
    if count > MAX_COPIES:
        raise complaint_at(root, location, f"asks for {count} copies; {MAX_COPIES} are allowed")
    written = find(template.root, template.location).value
    sections = {key.text: value for key, value in written.pairs if key.text in _SECTIONS}
    place = find(root, location).value
    for combination in product(*use.ranges.values()):
        running: dict[str, Parameter] = dict(zip(use.ranges, combination, strict=True))
        bound = dict(running)
        for key, value in use.given.items():
            try:
                bound[key] = _value(value, running)
            except ExpressionError as error:
                raise complaint_at(root, (*location, "with", key), str(error)) from error
        shown = ", ".join(f"{key}={bound[key]}" for key in parameters)
        by = f" with {shown}" if shown else ""
        note = f" (template {name}{by}, used in {root.file}:{place.line}:{place.column})"
        yield {key: _filled((*template.location, key), value, bound, note) for key, value in sections.items()}


def _value(given: Parameter, running: Mapping[str, Parameter]) -> Parameter:
    """Evaluate a given value: a whole expression to a number, one within a text to a text."""
    if not isinstance(given, str) or "$(" not in given:
        return given
    return evaluated(given[2:-1], running) if _is_whole(given) else substitute(given, running)


def _is_whole(text: str) -> bool:
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
        done += [text[at:begin], str(evaluated(text[begin + 2 : end - 1], values))]
        at = end
    return "".join([*done, text[at:]])


def evaluated(text: str, values: Mapping[str, Parameter]) -> Parameter:
    """Return the value of an expression with parameters as the only names: a whole number, or a text.

    Raises:
        ExpressionError: It has none.
    """

    def parameter(name: str, field: str) -> object:
        if field:
            raise ExpressionError(f"parameter {name} has no field '{field}'")
        return values[name]

    found = evaluate(parse(text, tuple(values)), parameter)
    if isinstance(found, bool) or not isinstance(found, int | str):
        raise ExpressionError(f"'{text}' is {as_text(found)}, neither a whole number nor a text")
    return found


def _filled(location: Location, value: Value, bound: Mapping[str, Parameter], note: str) -> Value:
    """Copy a value with the expressions evaluated; as deep as the file nests."""
    if value.kind is Kind.SCALAR:
        if "$(" not in value.text:
            return replace(value, note=note)
        try:
            quoted = value.quoted
            if quoted and _is_whole(value.text):  # quoted for YAML's sake: it keeps the type of its value
                quoted = not isinstance(evaluated(value.text[2:-1], bound), int | Written)
            return replace(value, text=substitute(value.text, bound), quoted=quoted, note=note)
        except ExpressionError as error:
            raise complaint(replace(value, note=note), str(error), location) from error
    if value.kind is Kind.LIST:
        return replace(value, children=tuple(_filled(location, v, bound, note) for v in value.children), note=note)
    pairs = tuple((_filled(location, k, bound, note), _filled(location, v, bound, note)) for k, v in value.pairs)
    return replace(value, pairs=pairs, note=note)


def _loops(path: Path) -> bool:
    """Return whether links lead back to the start."""
    try:
        path.resolve(strict=True)
    except (OSError, RuntimeError):
        return True
    return False


def _size(value: Value) -> int:
    if value.kind is Kind.SCALAR:
        return 1
    return 1 + sum(map(_size, value.children)) + sum(1 + _size(child) for _, child in value.pairs)
