"""Text of net files at any path, and complaints with file, line and column."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import pydantic

from im_core import files
from im_core.config import Fault, faults, field_name
from im_core.errors import nearest, quoted_text
from im_core.text.yamltext import Kind, Location, Value, YamlError, as_data, find, read_yaml
from im_pnt.errors import NetFileError
from im_pnt.netfile.schema.names import shown_name
from im_pnt.netfile.schema.scalars import WrongKeyError, written

MAX_YAML = 4 * files.MEBIBYTE
"""Largest YAML file [bytes]."""

ResultT = TypeVar("ResultT")


def read_text(path: Path, within: Sequence[Path] = ()) -> str:
    """Read a YAML file.

    Args:
        path: The file.
        within: Folders that the opened file must lie in; empty: it may lie anywhere.

    Raises:
        NetFileError: No such file, not a file, too large, not UTF-8, or outside of the folders.
    """
    try:
        return files.read_text(path, MAX_YAML, within=within)
    except files.FileError as error:
        raise _unread(error) from error


def read_bytes(path: Path, limit: int, within: Sequence[Path] = ()) -> bytes:
    """Read a file.

    Args:
        path: The file.
        limit: Largest size [bytes].
        within: As of :func:`read_text`.

    Raises:
        NetFileError: No such file, not a file, too large, or outside of the folders.
    """
    try:
        return files.read_bytes(path, limit, within=within)
    except files.FileError as error:
        raise _unread(error) from error


def _unread(error: files.FileError) -> NetFileError:
    return NetFileError(str(error.facts["file"]), error.line or 1, error.sentence, error.column)


def read_values(text: str, file: str) -> Value:
    """Read YAML text.

    Raises:
        NetFileError: It is not YAML, or more than a net can need.
    """
    if text.lstrip("\ufeff \n").startswith("<"):
        raise NetFileError(file, 1, "is XML; im pnt convert makes YAML of a net in .pnml, .xml or .tapn", 1)
    try:
        return read_yaml(text, file)
    except YamlError as error:
        raise complaint(error.place, error.sentence) from error


def read_data(root: Value) -> dict[str, object]:
    """Return a mapping of a file in the form of the models of net files.

    Raises:
        NetFileError: It is no mapping, or has a key twice, or one that is not a text.
    """
    if root.kind is not Kind.MAPPING and not root.is_null:
        raise complaint(root, f"{root.shown()} is not a mapping (key: value)")
    try:
        data = as_data(root, written)
    except YamlError as error:
        raise complaint(error.place, error.sentence, error.location) from error
    return data if isinstance(data, dict) else {}


def complaint(place: Value, sentence: str, location: Location = ()) -> NetFileError:
    """Make the error for a place of a file."""
    where = f"{field_name(location)}: " if location else ""
    return NetFileError(place.file, place.line, f"{where}{sentence}{place.note}", place.column)


def complaint_at(root: Value, location: Location, sentence: str, *, key: bool = False) -> NetFileError:
    """Make the error for the content of a location.

    Args:
        root: The file.
        location: Keys and indices that lead there.
        sentence: What is wrong.
        key: Whether to point at the key; otherwise at a scalar itself, and at the key of anything larger.
    """
    found = find(root, location)
    scalar = found.value.kind is Kind.SCALAR and not found.value.is_null
    place = found.value if found.key is None or (scalar and not key) else found.key
    return complaint(place, sentence, found.location)


def checked(
    root: Value,
    data: object,
    model: type[pydantic.BaseModel],
    validate: Callable[[object], ResultT],
    location: Location = (),
) -> ResultT:
    """Check data of a file.

    Args:
        root: The file.
        data: What it says, as :func:`read_data` returns it.
        model: The model that checks.
        validate: How it does.
        location: Where in the file the data stand.

    Raises:
        NetFileError: They are not what the model allows; of several faults the first in the file is named.
    """
    try:
        return validate(data)
    except pydantic.ValidationError as error:
        told = [_told(root, fault, location) for fault in faults(error, model)]
        raise min(told, key=lambda each: (each.facts["file"] != root.file, each.facts["line"])) from error


def _told(root: Value, fault: Fault, base: Location) -> NetFileError:
    """Return a fault in the sentences of net files."""
    at, limits = (*base, *fault.location), fault.limits
    match fault.kind:
        case "missing":
            return complaint_at(root, at[:-1], f"'{at[-1]}' is missing")
        case "extra_forbidden":
            sentence = f"'{shown_name(str(at[-1]))}' is not a known key{nearest(str(at[-1]), fault.known)}"
            found = find(root, at)
            return complaint(found.key or found.value, sentence, found.location[:-1])
        case "greater_than_equal":
            sentence = f"{fault.value} is not >= {limits['ge']}"
        case "less_than_equal":
            sentence = f"{fault.value} is not <= {limits['le']}"
        case "greater_than":
            sentence = f"{at[-1]} {fault.value} is not > {limits['gt']:g}"
        case "literal_error" if isinstance(fault.value, str):
            sentence = f"{fault.words}, not {quoted_text(fault.value)}"
        case _:
            sentence = fault.words
    return complaint_at(root, at, sentence, key=isinstance(limits.get("error"), WrongKeyError))
