"""Requests and goals of the client: each value is checked against the type of its field."""

import math
from typing import Any

import numpy as np

from im.errors import MachineError

#: So much of a wrong value is shown.
_SHOWN = 60


def message_of(kind: Any, **fields: object) -> Any:
    """Return a message of a type, with the given fields.

    The serialiser would meet a wrong value instead: it ends with an error of C, or cuts the value.

    Raises:
        MachineError: A value does not fit the type of its field; of code ``argument``.
    """
    message, types = kind(), kind.get_fields_and_field_types()
    message._check_fields = True
    for name, value in fields.items():
        try:
            setattr(message, name, _fitting(types[name], value))
        except (AssertionError, TypeError, ValueError, OverflowError) as error:
            told = f"{name} is of type {types[name]} and cannot be {value!r:.{_SHOWN}}"
            raise MachineError(told, "argument", {"field": name}) from error
    return message


def number_of(name: str, value: Any) -> float:
    """Return a value as a number.

    Raises:
        MachineError: It is none, or not finite; of code ``argument``.
    """
    try:
        if not isinstance(value, str) and math.isfinite(number := float(value)):
            return number
    except (TypeError, ValueError, OverflowError):
        pass
    raise MachineError(f"{name} is {value!r:.{_SHOWN}}, not a finite number", "argument", {"field": name})


def _fitting(kind: str, value: object) -> object:
    """Return a value as its field takes it: numbers of numpy as plain ones, 1 for 1.0."""
    if isinstance(value, np.generic):
        value = value.item()
    for text in value if isinstance(value, list | tuple) else [value]:
        if isinstance(text, str) and b"\0" in text.encode():  # texts of ROS end with a zero
            raise ValueError(text)
    if kind in ("float", "double") and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value
