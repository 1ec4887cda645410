"""A net file put together: included files read, templates copied where they are used."""

from pathlib import Path

from im_pnt.errors import NetFileError
from im_pnt.netfile import keys
from im_pnt.netfile.node import Node
from im_pnt.netfile.source import read_text
from im_pnt.netfile.templates import Template, copies, read_template
from im_pnt.netfile.value import Kind, Value, mapping, scalar, sequence
from im_pnt.netfile.yamltext import MAX_VALUES, read_yaml

MAX_INCLUDES = 8
MAX_FILES = 100
_MAPPINGS = ("places", "services", "transitions")


def assemble(root: Node, file: Path | None) -> Node:
    """Reads what a net file includes, and copies the templates that it uses.

    Args:
        root: The file as written.
        file: Where it is; None: nowhere, and it can include nothing.

    Returns:
        The same net without ``include``, ``templates`` and ``use``.

    Raises:
        NetFileError: A file that cannot be included, includes that go round, or a template that cannot be used.
    """
    entries = root.items(keys.NET)
    if not entries.keys() & {"include", "templates", "use"}:
        return root
    assembly = _Assembly()
    assembly.add(entries, () if file is None else (file,))
    assembly.copy()
    pairs: list[tuple[Value, Value]] = []
    for name, node in entries.items():
        if name not in keys.FRAGMENT and node.key is not None:
            pairs.append((node.key, node.value))
    for name in _MAPPINGS:
        if name in assembly.sections:
            near = entries[name].key or root.value if name in entries else root.value
            pairs.append((scalar(name, near), mapping(assembly.sections[name], near)))
    if assembly.rest is not None:
        near = entries["rest"].key or root.value if "rest" in entries else root.value
        pairs.append((scalar("rest", near), sequence(assembly.rest, near)))
    return Node(mapping(pairs, root.value))


class _Assembly:
    def __init__(self) -> None:
        self.sections: dict[str, list[tuple[Value, Value]]] = {}
        self.rest: list[Value] | None = None
        self._templates: dict[str, Template] = {}
        self._uses: list[Node] = []
        self._read: set[Path] = set()
        self._values = 0

    def add(self, entries: dict[str, Node], chain: tuple[Path, ...]) -> None:
        """Adds a file, those that it includes first."""
        for element in entries["include"].elements() if "include" in entries else ():
            self._include(element, chain)
        for name, node in entries["templates"].items().items() if "templates" in entries else ():
            template = read_template(name, node)
            if name in self._templates:
                first = self._templates[name].node
                raise node.key_error(f"template '{name}' is there twice; the first is in {first.file}:{first.line}")
            self._templates[name] = template
        if "use" in entries:
            uses = entries["use"]
            self._uses.extend([uses] if uses.is_mapping else uses.elements())
        self._sections(entries)

    def copy(self) -> None:
        """Makes the copies of templates; all of them are known now."""
        for use in self._uses:
            for sections in copies(use, self._templates):
                self._sections(sections)
                self._values += sum(_size(node.value) for node in sections.values())
                if self._values > MAX_VALUES:
                    raise use.error(f"the copies of templates make more than {MAX_VALUES} values")

    def _sections(self, entries: dict[str, Node]) -> None:
        for name in _MAPPINGS:
            if name in entries:
                node = entries[name]
                section = self.sections.setdefault(name, [])
                if not node.is_null:
                    node.items()
                    section.extend(node.value.pairs)
        if "rest" in entries:
            self.rest = [*(self.rest or []), *(element.value for element in entries["rest"].elements())]

    def _include(self, element: Node, chain: tuple[Path, ...]) -> None:
        name = element.text()
        if not chain:
            raise element.error(f"'{name}' cannot be included: this net is a text without a file")
        path = chain[-1].parent / name
        real = path.resolve() if "\0" not in name and not _loops(path) else path
        way = [each.resolve() for each in chain]
        if real in way:
            names = " -> ".join(str(each) for each in [*chain[way.index(real) :], path])
            raise element.error(f"includes go round: {names}")
        if len(chain) > MAX_INCLUDES:
            names = " -> ".join(str(each) for each in [*chain, path])
            raise element.error(f"includes are deeper than {MAX_INCLUDES}: {names}")
        if real in self._read:
            return
        self._read.add(real)
        if len(self._read) > MAX_FILES:
            raise element.error(f"more than {MAX_FILES} files are included")
        try:
            text = read_text(path)
        except NetFileError as error:
            raise element.error(f"cannot be included: {error.message}") from error
        root = Node(read_yaml(text, str(path)))
        entries = root.items()
        if "net" in entries:
            raise entries["net"].key_error(
                f"a file that is included (by {element.file}:{element.value.line}) is no net of its own; "
                f"it may have {', '.join(keys.FRAGMENT)}"
            )
        self.add(root.items(keys.FRAGMENT), (*chain, path))


def _loops(path: Path) -> bool:
    """Whether links lead back to themselves."""
    try:
        path.resolve(strict=True)
    except (OSError, RuntimeError):
        return True
    return False


def _size(value: Value) -> int:
    if value.kind is Kind.SCALAR:
        return 1
    return 1 + sum(map(_size, value.children)) + sum(1 + _size(child) for _, child in value.pairs)
