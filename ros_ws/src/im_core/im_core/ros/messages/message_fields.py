"""Messages as plain data, and messages from plain data: fields by name, as JSON and YAML have them."""

import array
import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from im_core.errors import DataError, NotFoundError, shortened
from im_core.ros.messages.interfaces import message_class

#: Type of a field that is a sequence or an array, and that of its elements.
_ELEMENTS = re.compile(r"sequence<(?P<sequence>.*?)(?:, \d+)?>|(?P<array>[^<\[]+)\[\d+\]")
#: So much is said of a value that does not fit.
_LONGEST_SHOWN = 80


def fields_of(value: Any) -> object:
    """Return a message, or a value of a field, as plain data; infinite numbers are texts there."""
    if hasattr(value, "get_fields_and_field_types"):
        return {field: fields_of(getattr(value, field)) for field in value.get_fields_and_field_types()}
    if isinstance(value, np.ndarray | array.array):
        return [fields_of(each) for each in value.tolist()]
    if isinstance(value, list | tuple):
        return [fields_of(each) for each in value]
    if isinstance(value, bytes):  # an octet
        return value[0]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def filled(message: Any, fields: Any, where: str) -> Any:
    """Set fields of a message from plain data; return the message.

    Args:
        message: A message, request or goal; fields that are not given stay.
        fields: Values by name; a mapping fills a nested message, which may also be given as a message, and texts such
            as ``inf`` a number.
        where: What is filled, for errors.

    Raises:
        DataError: A value does not fit.
        NotFoundError: There is no such field.
    """
    if not isinstance(fields, Mapping):
        raise DataError(f"{where} cannot be {_shown(fields)}: the fields of a message are needed", field=where)
    types = message.get_fields_and_field_types()
    message._check_fields = True  # a wrong type would else be met by the serialiser, which ends the process
    for field, value in fields.items():
        if field not in types:
            raise NotFoundError(kind=f"field of {where}", name=field, known=types)
        try:
            setattr(message, field, _fitting(getattr(message, field), types[field], value, f"{where}.{field}"))
        except (AssertionError, TypeError, ValueError, OverflowError) as error:
            raise DataError(f"{where}.{field} ({types[field]}) cannot be {_shown(value)}", field=field) from error
    return message


def _shown(value: object) -> str:
    return shortened(repr(value), _LONGEST_SHOWN)


def _fitting(present: Any, kind: str, value: Any, where: str) -> Any:
    if isinstance(value, Mapping) and hasattr(present, "get_fields_and_field_types"):
        return filled(type(present)(), value, where)
    if isinstance(value, list | tuple):
        found = _ELEMENTS.fullmatch(kind)
        element = (found["sequence"] or found["array"]) if found else ""
        if "/" not in element:
            return [_number(element, each) for each in value]
        make = message_class(element.replace("/", "/msg/"))
        return [
            each if hasattr(each, "get_fields_and_field_types") else filled(make(), each, f"{where}[{number}]")
            for number, each in enumerate(value)
        ]
    return _number(kind, value)


def _number(kind: str, value: Any) -> Any:
    """Convert a number of JSON: 1 for 1.0, texts for infinite numbers; texts of ROS end with a zero."""
    if isinstance(value, str) and "\0" in value:
        raise ValueError(value)
    if kind in ("float", "double") and not isinstance(value, bool):
        return float(value)
    return bytes([value]) if kind == "octet" else value
