"""Assembly of a net file: included files read, templates copied in the places."""

import os
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import cast

from im_core.errors import DataError, nearest, quoted_text
from im_core.message_paths import resolve_below
from im_core.text.yamltext import MAX_VALUES, Kind, Location, Value, find, mapping, scalar, sequence
from im_pnt.errors import NetFileError
from im_pnt.expression.errors import ExpressionError
from im_pnt.netfile.interrupts import Interrupt
from im_pnt.netfile.parameters import with_parameters
from im_pnt.netfile.schema.net import FragmentFile
from im_pnt.netfile.schema.templates import Parameter, UseFile
from im_pnt.netfile.subnets import Subnets, uses_subnets
from im_pnt.netfile.substitution import Template, evaluated, filled, is_whole, size, substitute
from im_pnt.netfile.text import checked, complaint_at, read_data, read_text, read_values

MAX_COPIES = 10_000
_COUNTED = 10**30
MAX_INCLUDES = 8
MAX_FILES = 100
_MAPPINGS = ("places", "services", "commands", "transitions")
_SECTIONS = (*_MAPPINGS, "rest")


def assemble(
    root: Value, file: Path | None, within: Sequence[Path] = (), sent: Mapping[str, str] | None = None
) -> Value:
    """Read the included files of a net file, and copy the used templates.

    Args:
        root: The file as written.
        file: Where it is; None: nowhere, and it can include nothing.
        within: Folders that included files lie below; empty: they may lie anywhere.
        sent: Texts of the files that came with the net, by the path from its folder; only others are read. None: the
            net was not sent.

    Returns:
        The same net without ``parameters``, ``include``, ``templates``, ``interrupts`` and ``use``, those of
        transitions too.

    Raises:
        NetFileError: A file that cannot be included, includes that go round, or a template that cannot be used.
        MissingPartsError: A file needs more of its parameters than there is.
    """
    fragment = FragmentFile.model_fields.keys()
    assembled = {"include", "templates", "use", "interrupts", "parameters"}
    if not {key.text for key, _ in root.pairs} & assembled and not uses_subnets(root):
        return root
    assembly = _Assembly(within, file, sent)
    root, given = with_parameters(root)
    own = {key: value for key, value in read_data(root).items() if key in fragment}
    assembly.add(root, own, () if file is None else (file,), given)
    assembly.copy()
    pairs = [(key, value) for key, value in root.pairs if key.text not in fragment]
    for name, section in assembly.sections.items():
        near = next((key for key, _ in root.pairs if key.text == name), root)
        pairs.append((scalar(name, near), mapping(section, near)))
    if assembly.rest is not None:
        near = next((key for key, _ in root.pairs if key.text == "rest"), root)
        pairs.append((scalar("rest", near), sequence(assembly.rest, near)))
    return mapping(pairs, root)


class _Assembly:
    """Sections of all files and copies."""

    def __init__(self, within: Sequence[Path], file: Path | None, sent: Mapping[str, str] | None) -> None:
        folder = Path() if file is None else file.parent
        self._within, self._is_sent = within, sent is not None
        self._sent = {_normal(folder / name): (name, text) for name, text in (sent or {}).items()}
        self.sections: dict[str, list[tuple[Value, Value]]] = {}
        self.rest: list[Value] | None = None
        self._templates: dict[str, Template] = {}
        self._uses: list[tuple[Value, Location, UseFile]] = []
        self._interrupts: list[Interrupt] = []
        self._read: set[Path] = set()
        self._values = 0

    def add(
        self, root: Value, data: Mapping[str, object], chain: tuple[Path, ...], given: Mapping[str, Parameter]
    ) -> None:
        """Add a file with the values of its parameters, after the included ones."""
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
            self._templates[name] = Template(template, root, location, given)
        for name, interrupt in fragment.interrupts.items():
            if name in {other.name for other in self._interrupts}:
                raise complaint_at(
                    root, ("interrupts", name), f"interrupt {quoted_text(name)} is there twice", key=True
                )
            self._interrupts.append(Interrupt(name, interrupt, find(root, ("interrupts", name)).value))
        self._uses += [(root, ("use", rank), use) for rank, use in enumerate(fragment.use)]
        self._add_sections({key.text: value for key, value in root.pairs if key.text in _SECTIONS}, root, ())

    def copy(self) -> None:
        """Make the copies of templates, all templates being known now."""
        for root, location, use in self._uses:
            if use.template not in self._templates:
                sentence = f"there is no template {quoted_text(use.template)}{nearest(use.template, self._templates)}"
                raise complaint_at(root, (*location, "template"), sentence)
            template = self._templates[use.template]
            if template.file.ports is not None:
                sentence = f"template {use.template} has ports: a transition uses it, with 'use'"
                raise complaint_at(root, (*location, "template"), sentence)
            for sections in _copies(root, location, use, template):
                self._add_sections(sections, template.root, template.location)
                self._values += sum(size(value) for value in sections.values())
                if self._values > MAX_VALUES:
                    sentence = f"the copies of templates make more than {MAX_VALUES} values"
                    raise complaint_at(root, location, sentence)
        subnets = Subnets(self._templates, self._interrupts)
        self.sections, self.rest = subnets.replaced(self.sections, self.rest)

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
        sent = self._sent.get(_normal(path))
        if self._within and sent is None:
            try:
                resolve_below(str(path), self._within, "include")
            except DataError as error:
                raise complaint_at(root, location, self._unsent(name) or error.message) from error
        # else resolve raises; reading names the fault
        real = self._real(path)
        way = [self._real(each) for each in chain]
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
            named, text = sent or (str(path), read_text(path, self._within))
        except NetFileError as error:
            sentence = self._unsent(name) or f"cannot be included: {error.message}"
            raise complaint_at(root, location, sentence) from error
        included, given = with_parameters(read_values(text, named))
        data = read_data(included)
        if "net" in data:
            by = find(root, location).value
            sentence = (
                f"a file that is included (by {root.file}:{by.line}) is no net of its own; "
                f"it may have {', '.join(FragmentFile.model_fields)}"
            )
            raise complaint_at(included, ("net",), sentence, key=True)
        self.add(included, data, (*chain, path), given)

    def _unsent(self, name: str) -> str:
        """Return the sentence for a file that did not come with a sent net; empty: the net was not sent."""
        sentence = f"{quoted_text(name)} cannot be included: it was not sent with the net, and is no shipped file"
        return sentence if self._is_sent else ""

    def _real(self, path: Path) -> Path:
        """Return the file that a path means."""
        normal = _normal(path)
        return normal if normal in self._sent or "\0" in str(path) or _loops(path) else path.resolve()


def _copies(root: Value, location: Location, use: UseFile, template: Template) -> Iterator[dict[str, Value]]:
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
        bound = {**template.given, **running}
        for key, value in use.given.items():
            try:
                bound[key] = _value(value, running)
            except ExpressionError as error:
                raise complaint_at(root, (*location, "with", key), str(error)) from error
        shown = ", ".join(f"{key}={bound[key]}" for key in parameters)
        by = f" with {shown}" if shown else ""
        note = f" (template {name}{by}, used in {root.file}:{place.line}:{place.column})"
        yield {key: filled((*template.location, key), value, bound, note) for key, value in sections.items()}


def _value(given: Parameter, running: Mapping[str, Parameter]) -> Parameter:
    """Evaluate a given value: a whole expression to a number, one within a text to a text."""
    if isinstance(given, list):
        return [_value(cast(Parameter, each), running) for each in given]
    if isinstance(given, dict):
        return {name: _value(cast(Parameter, each), running) for name, each in given.items()}
    if not isinstance(given, str) or "$(" not in given:
        return given
    return evaluated(given[2:-1], running) if is_whole(given) else substitute(given, running)


def _normal(path: Path) -> Path:
    """Return a path without ``.`` and ``..``, by its letters alone."""
    return Path(os.path.normpath(path))


def _loops(path: Path) -> bool:
    """Return whether links lead back to the start."""
    try:
        path.resolve(strict=True)
    except (OSError, RuntimeError):
        return True
    return False
