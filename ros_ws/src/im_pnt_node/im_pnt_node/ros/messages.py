"""Messages as plain data: the types of fields, and the fields that expressions of nets need."""

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from im_core.errors import ConfigError, ImError, NotFoundError
from im_core.ros.messages.interfaces import interface_class, type_name
from im_pnt.expression.types import ValueType, field_type

_PARTS = ("_Request", "_Response", "_Goal", "_Result")


class RosTypes:
    """Field types of the installed messages."""

    def fields(self, message: str) -> Mapping[str, ValueType] | None:
        """Return the types of the fields of a message, request, response, goal or result.

        Raises:
            ConfigError: There is no such type.
        """
        try:
            return _fields(message)
        except NotFoundError as error:
            hint = "types are those of packages whose install/setup.bash was sourced before the start"
            raise ConfigError(f"{error.message}; {hint}", type=message) from error


@cache
def _fields(message: str) -> Mapping[str, ValueType]:
    part = next((part for part in _PARTS if "/msg/" not in message and message.endswith(part)), "")
    found = interface_class(message.removesuffix(part))
    if part:
        found = getattr(found, part[1:])
    return {name: field_type(text) for name, text in found.get_fields_and_field_types().items()}


def packed_message(message: object) -> list[str]:
    """Return a message as JSON data."""
    from rclpy.serialization import serialize_message  # the process that verifies nets asks for types, and has no ROS

    from im_pnt_node.rerun.log import packed

    return packed(type_name(type(message)), serialize_message(message))


def plain_fields(message: Any, ways: Sequence[tuple[str, ...]], where: str) -> dict[str, object]:
    """Return some fields of a message as JSON data.

    Args:
        message: The message.
        ways: Ways to the fields, by name, through lists of messages too; an empty one leads to all.
        where: What the message is, for complaints.

    Raises:
        ImError: A field is a number that is not finite, or cannot be JSON.
    """
    fields: dict[str, object] = {}
    for way in ways:
        _keep(fields, message, way, where)
    return fields


def _keep(fields: dict[str, object], message: Any, way: tuple[str, ...], where: str) -> None:
    for name in way[:1] or message.get_fields_and_field_types():
        value, rest = getattr(message, name), way[1:]
        if not rest:
            fields[name] = _plain(value, f"{where}.{name}")
        elif isinstance(value, list):
            elements = fields.setdefault(name, [{} for _ in value])
            assert isinstance(elements, list)
            for rank, (element, part) in enumerate(zip(elements, value, strict=True)):
                _keep(element, part, rest, f"{where}.{name}[{rank}]")
        else:
            below = fields.setdefault(name, {})
            assert isinstance(below, dict)
            _keep(below, value, rest, f"{where}.{name}")


def _plain(value: Any, where: str) -> object:
    if isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ImError(f"{where} is {value}, which is no finite number and cannot be kept", code="expression")
        return value
    if hasattr(value, "get_fields_and_field_types"):
        return {name: _plain(getattr(value, name), f"{where}.{name}") for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return list(value)
    if hasattr(value, "tolist"):
        return _plain(value.tolist(), where)
    return [_plain(each, f"{where}[{rank}]") for rank, each in enumerate(value)]
