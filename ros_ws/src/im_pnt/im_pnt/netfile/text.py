"""Text of net files, whatever the path leads to, and complaints that name file, line and column."""

import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pydantic

from im_core.config import Fault, faults, field_name
from im_core.errors import nearest
from im_core.yamltext import Kind, Location, Value, YamlError, as_data, find, read_yaml
from im_pnt.errors import NetFileError
from im_pnt.netfile.schema import WrongKeyError, written

MAX_YAML = 4 * 2**20
"""Largest YAML file [bytes]."""

ResultT = TypeVar("ResultT")


def read_text(path: Path) -> str:
    """Reads a YAML file.

    Raises:
        NetFileError: No such file, not a file, too large, or not UTF-8.
    """
    data = read_bytes(path, MAX_YAML)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        column = error.start - data.rfind(b"\n", 0, error.start)
        raise NetFileError(str(path), line, f"is not UTF-8 text: {error.reason}", column) from error


def read_bytes(path: Path, limit: int) -> bytes:
    """Reads a file.

    Args:
        path: The file.
        limit: Largest size [bytes].

    Raises:
        NetFileError: No such file, not a file, or too large.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as file:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise NetFileError(str(path), 1, "cannot be read: it is not a regular file")
            data = file.read(limit + 1)
    except OSError as error:
        raise NetFileError(str(path), 1, f"cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise NetFileError(repr(str(path)), 1, f"cannot be read: {error}") from error
    if len(data) > limit:
        raise NetFileError(str(path), 1, f"is larger than {limit / 2**20:g} MiB; a net may not be")
    return data


def read_values(text: str, file: str) -> Value:
    """Reads YAML text.

    Raises:
        NetFileError: It is not YAML, or more than a net can need.
    """
    try:
        return read_yaml(text, file)
    except YamlError as error:
        raise complaint(error.place, error.sentence) from error


def read_data(root: Value) -> dict[str, object]:
    """Returns a mapping of a file as the models of net files take it.

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
    """Makes the error that names a place of a file."""
    where = f"{field_name(location)}: " if location else ""
    return NetFileError(place.file, place.line, f"{where}{sentence}{place.note}", place.column)


def complaint_at(root: Value, location: Location, sentence: str, *, key: bool = False) -> NetFileError:
    """Makes the error about what stands at a location.

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
    """Checks data of a file.

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
    """Says a fault in the sentences of net files."""
    at, limits = (*base, *fault.location), fault.limits
    match fault.kind:
        case "missing":
            return complaint_at(root, at[:-1], f"'{at[-1]}' is missing")
        case "extra_forbidden":
            sentence = f"'{at[-1]}' is not a known key{nearest(str(at[-1]), fault.known)}"
            found = find(root, at)
            return complaint(found.key or found.value, sentence, found.location[:-1])
        case "greater_than_equal":
            sentence = f"{fault.value} is not >= {limits['ge']}"
        case "less_than_equal":
            sentence = f"{fault.value} is not <= {limits['le']}"
        case "greater_than":
            sentence = f"{at[-1]} {fault.value} is not > {limits['gt']:g}"
        case _:
            sentence = fault.words
    return complaint_at(root, at, sentence, key=isinstance(limits.get("error"), WrongKeyError))
