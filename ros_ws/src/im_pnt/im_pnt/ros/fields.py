"""Plain data into ROS messages."""

import importlib
import re
from collections.abc import Mapping
from typing import Any

from im_pnt.errors import NetError, nearest

_SEQUENCE = re.compile(r"(?:sequence<(?P<bounded>[^,>]+)(?:, *\d+)?>|(?P<array>[^\[]+)\[\d*\])")


def interface_class(name: str) -> Any:
    """Returns the class of ``package/srv/Type``, ``package/action/Type`` or ``package/msg/Type``.

    Raises:
        NetError: No such package or type.
    """
    package, kind, type_name = name.split("/") if name.count("/") == 2 else (*name.split("/"), "")[:3]
    try:
        module = importlib.import_module(f"{package}.{kind}")
    except ImportError as error:
        raise NetError(f"interface {name}: there is no package {package} with {kind} types ({error})") from error
    if not hasattr(module, type_name):
        known = [entry for entry in vars(module) if entry[:1].isupper()]
        raise NetError(f"interface {name}: {package} has no {kind} type {type_name}{nearest(type_name, known)}")
    return getattr(module, type_name)


def fill(message: Any, fields: Mapping[str, object], where: str) -> Any:
    """Sets fields of a message from plain data or from messages; returns the message.

    Args:
        message: A message, request or goal.
        fields: Values by name; a mapping fills a nested message.
        where: What is filled, for messages.

    Raises:
        NetError: No such field, or a value that does not fit.
    """
    types = message.get_fields_and_field_types()
    message._check_fields = True  # otherwise a wrong type is met first by the serialiser, which aborts the process
    for name, value in fields.items():
        if name not in types:
            raise NetError(f"{where} has no field '{name}'{nearest(name, types)}", field=name)
        try:
            setattr(message, name, _fitted(getattr(message, name), types[name], value, f"{where}.{name}"))
        except (AssertionError, TypeError, ValueError) as error:
            raise NetError(f"{where}.{name} ({types[name]}) cannot be {value!r}: {error}", field=name) from error
    return message


def _fitted(present: Any, type_name: str, value: Any, where: str) -> Any:
    if isinstance(value, Mapping) and hasattr(present, "get_fields_and_field_types"):
        return fill(present, value, where)
    match = _SEQUENCE.fullmatch(type_name)
    if match and isinstance(value, list | tuple):
        element = match.group("bounded") or match.group("array")
        if "/" in element:
            make = interface_class(element.replace("/", "/msg/"))
            return [
                fill(make(), entry, f"{where}[{index}]") if isinstance(entry, Mapping) else entry
                for index, entry in enumerate(value)
            ]
        return [_number(entry, element) for entry in value]
    return _number(value, type_name)


def _number(value: Any, type_name: str) -> Any:
    """YAML writes 1 where a message wants 1.0."""
    whole = isinstance(value, int) and not isinstance(value, bool)
    return float(value) if whole and type_name in ("double", "float") else value
