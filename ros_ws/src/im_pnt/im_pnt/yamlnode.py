"""YAML values that remember their line, so that every complaint about a net file can name it."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import yaml

from im_pnt.errors import NetFileError, nearest


class YamlNode:
    """A value of a YAML file with its file and line."""

    def __init__(self, node: yaml.Node, file: str, path: str = "") -> None:
        self._node = node
        self.file = file
        self.path = path
        self.line: int = node.start_mark.line + 1

    def error(self, message: str) -> NetFileError:
        """Makes the error that names this value's file and line."""
        where = f"{self.path}: " if self.path else ""
        return NetFileError(self.file, self.line, f"{where}{message}")

    @property
    def is_null(self) -> bool:
        """Whether nothing is written here."""
        return self._node.tag == "tag:yaml.org,2002:null"

    @property
    def is_mapping(self) -> bool:
        """Whether this is a mapping."""
        return isinstance(self._node, yaml.MappingNode)

    @property
    def is_list(self) -> bool:
        """Whether this is a list."""
        return isinstance(self._node, yaml.SequenceNode)

    def items(self, known: Iterable[str] | None = None) -> dict[str, "YamlNode"]:
        """Returns the entries of a mapping.

        Args:
            known: Keys that are allowed; None: any.

        Raises:
            NetFileError: Not a mapping, a key twice, or a key that is not known.
        """
        if self.is_null:
            return {}
        if not isinstance(self._node, yaml.MappingNode):
            raise self.error(f"{self.shown()} is not a mapping (key: value)")
        allowed = None if known is None else set(known)
        entries: dict[str, YamlNode] = {}
        for key_node, value_node in self._node.value:
            key = YamlNode(key_node, self.file, self.path)
            name = key.text()
            if name in entries:
                raise key.error(f"'{name}' is there twice; the first is in line {entries[name].line}")
            if allowed is not None and name not in allowed:
                raise key.error(f"'{name}' is not a known key{nearest(name, allowed)}")
            entries[name] = YamlNode(value_node, self.file, f"{self.path}.{name}" if self.path else name)
            entries[name].line = key.line
        return entries

    def elements(self) -> Iterator["YamlNode"]:
        """Iterates over a list; a single value counts as a list of one.

        Raises:
            NetFileError: A mapping.
        """
        if self.is_null:
            return
        if isinstance(self._node, yaml.SequenceNode):
            for index, child in enumerate(self._node.value):
                yield YamlNode(child, self.file, f"{self.path}[{index}]")
        elif isinstance(self._node, yaml.ScalarNode):
            yield self
        else:
            raise self.error(f"{self.shown()} is not a list")

    def text(self) -> str:
        """Returns a scalar as text.

        Raises:
            NetFileError: Not a scalar, or nothing.
        """
        if not isinstance(self._node, yaml.ScalarNode) or self.is_null:
            raise self.error(f"{self.shown()} is not a text")
        return str(self._node.value)

    def integer(self, minimum: int) -> int:
        """Returns a whole number.

        Raises:
            NetFileError: Not a whole number, or less than the minimum.
        """
        value = self.plain()
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(f"{self.shown()} is not a whole number")
        if value < minimum:
            raise self.error(f"{value} is not >= {minimum}")
        return value

    def positive(self) -> float:
        """Returns a number greater than zero.

        Raises:
            NetFileError: Not a number greater than zero.
        """
        value = self.plain()
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
            raise self.error(f"{self.shown()} is not a number > 0")
        return float(value)

    def boolean(self) -> bool:
        """Returns true or false.

        Raises:
            NetFileError: Neither.
        """
        value = self.plain()
        if not isinstance(value, bool):
            raise self.error(f"{self.shown()} is neither true nor false")
        return value

    def plain(self) -> object:
        """Returns the value as plain Python.

        Raises:
            NetFileError: A tag or value that plain YAML does not have.
        """
        loader = yaml.SafeLoader("")
        try:
            value: object = loader.construct_document(self._node)
        except (yaml.YAMLError, ValueError) as error:
            raise self.error(f"{self.shown()} cannot be read ({error})") from error
        finally:
            loader.dispose()
        return value

    def shown(self) -> str:
        """Returns a short form of the value for messages."""
        if isinstance(self._node, yaml.ScalarNode):
            return "nothing" if self.is_null else repr(self._node.value)
        return "a mapping" if self.is_mapping else "a list"


def read_yaml(text: str, file: str) -> YamlNode:
    """Parses one YAML document.

    Args:
        text: The document.
        file: Its name in messages.

    Raises:
        NetFileError: Not YAML, empty, more than one document, or with aliases that contain themselves.
    """
    try:
        node = yaml.compose(text, yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise NetFileError(file, mark.line + 1 if mark else 1, f"not YAML: {error.problem}") from error
    except (yaml.YAMLError, RecursionError) as error:
        raise NetFileError(file, 1, f"not YAML: {' '.join(str(error).split())}") from error
    if node is None:
        raise NetFileError(file, 1, "the file is empty")
    return YamlNode(node, file)


def read_file(path: Path) -> YamlNode:
    """Reads one YAML document from a file.

    Raises:
        NetFileError: No such file, not text, or not YAML.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise NetFileError(str(path), 1, f"cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise NetFileError(str(path), 1, f"is not UTF-8 text: {error.reason}") from error
    return read_yaml(text, str(path))
