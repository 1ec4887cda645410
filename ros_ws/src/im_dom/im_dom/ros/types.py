"""Types of data objects: check of bytes as a message, the hash of a definition, and a message as JSON."""

import functools
import json
import re
from pathlib import Path
from typing import Any

from ament_index_python import PackageNotFoundError, get_package_share_directory
from rclpy.serialization import serialize_message

from im_core.errors import DataError, NotFoundError
from im_core.files import MEBIBYTE, read_text
from im_core.ros.messages.interfaces import decoded, message_class
from im_core.ros.messages.message_fields import fields_of, filled
from im_core.text.bounded_json import read_json

#: CDR ends with at most so many bytes that mean nothing.
PADDING = 3

#: Type of a field that is a sequence.
_SEQUENCE = re.compile(r"sequence<.*?(?:, (?P<most>\d+))?>")

#: A larger object is given out as it is, not as text [bytes].
LARGEST_AS_TEXT = MEBIBYTE


def check_message(name: str, kind: str, data: bytes) -> str:
    """Check whether bytes are a message of a type.

    Args:
        name: Of the object, for the error.
        kind: ROS type; its package must have been sourced when this process began.
        data: The bytes (CDR).

    Returns:
        The hash of the type's definition (REP 2016).

    Raises:
        DataError: They are not, or it is the type of no messages.
        NotFoundError: No such type is installed.
    """
    message = _decoded(name, kind, data)
    surplus = len(data) - len(serialize_message(message))
    if surplus > PADDING:
        text = f"data object '{name}' is no {kind}: {surplus} of its {len(data)} bytes follow after the end of one"
        raise DataError(text, object=name, type=kind)
    return type_hash(kind)


def extended(name: str, kind: str, data: bytes, more: bytes) -> bytes:
    """Return a message with sequences extended by the ones of another message; the other fields stay.

    Args:
        name: Of the object, for errors.
        kind: ROS type of both.
        data: The message (CDR).
        more: The other one (CDR).

    Returns:
        The longer message (CDR).

    Raises:
        DataError: The type has no sequences, one would be longer than its type allows, or the bytes do not decode.
    """
    message, added = _decoded(name, kind, data), _decoded(name, kind, more)
    found = {field: _SEQUENCE.fullmatch(of) for field, of in message.get_fields_and_field_types().items()}
    sequences = {field: match for field, match in found.items() if match}
    if not sequences:
        raise DataError(f"data object '{name}' is a {kind}, which has no sequence to append to", object=name, type=kind)
    for field, match in sequences.items():
        present, further = getattr(message, field), getattr(added, field)
        length, most = len(present) + len(further), match["most"]
        if most is not None and length > int(most):
            text = f"data object '{name}': {field} would have {length} elements; at most {most} are allowed"
            raise DataError(text, object=name, field=field, length=length, allowed=int(most))
        present.extend(further)
    longer: bytes = serialize_message(message)
    return longer


@functools.cache
def type_hash(kind: str) -> str:
    """The hash of the definition of a type.

    Raises:
        NotFoundError: Its package does not tell.
    """
    package, folder, name = kind.split("/")
    try:
        text = read_text(Path(get_package_share_directory(package)) / folder / f"{name}.json")
        hashes = {str(each["type_name"]): str(each["hash_string"]) for each in json.loads(text)["type_hashes"]}
        return hashes[kind]
    except (PackageNotFoundError, DataError, ValueError, KeyError, TypeError) as error:
        raise NotFoundError(kind="hash of type", name=kind) from error


def as_json(name: str, kind: str, data: bytes) -> str:
    """Return the fields of a message as JSON; infinite numbers are texts there.

    Raises:
        DataError: The bytes are none of that type any more, or too many.
    """
    if len(data) > LARGEST_AS_TEXT:
        text = f"data object '{name}' has {len(data)} bytes; at most {LARGEST_AS_TEXT} are given as text"
        raise DataError(text, object=name, size=len(data), allowed=LARGEST_AS_TEXT)
    return json.dumps(fields_of(_decoded(name, kind, data)))


def from_json(name: str, kind: str, text: str) -> bytes:
    """Return the message (CDR) with fields in the form of :func:`as_json`; missing ones keep the defaults.

    Raises:
        DataError: It is no JSON, a field does not fit, or it is the type of no messages.
        NotFoundError: No such type is installed, or it has no such field.
    """
    if len(text) > LARGEST_AS_TEXT:
        said = f"data object '{name}' is told in {len(text)} characters; at most {LARGEST_AS_TEXT} are read"
        raise DataError(said, object=name, size=len(text), allowed=LARGEST_AS_TEXT)
    fields = read_json(dict[str, Any], text, f"the JSON of data object '{name}'")
    data: bytes = serialize_message(filled(message_class(kind)(), fields, kind))
    return data


def _decoded(name: str, kind: str, data: bytes) -> Any:
    interface = message_class(kind)
    try:
        return decoded(data, interface)
    except DataError as error:
        text = f"data object '{name}' is no {kind}: its {len(data)} bytes do not decode"
        raise DataError(text, object=name, type=kind) from error
