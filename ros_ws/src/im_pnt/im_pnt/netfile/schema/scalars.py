"""Values of a net file in the form of the models.

A value that an author may write shortly (``a: 1`` for a place, ``in: a`` for arcs, ``delay: 2.5``) is brought into its
long form before it is checked; a scalar keeps how it is written, for it may stand where a text is wanted.
"""

import math

from im_core.config import FieldError
from im_core.errors import quoted_text
from im_core.text.yamltext import Value, control_character, plain_scalar


class WrongKeyError(FieldError):
    """Rule broken by a key, not by the value."""


class Written(str):
    """Unquoted number or truth value: the text, and the value."""

    __slots__ = ("value",)
    value: object


def written(value: Value) -> object:
    """Return a scalar in the form of the models: a text, None, or :class:`Written`."""
    data = plain_scalar(value)
    if isinstance(data, str) or data is None:
        return data
    scalar = Written(value.text)
    scalar.value = data
    return scalar


def shown(value: object) -> str:
    """Return a value for messages."""
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list):
        return "a list"
    return "nothing" if value is None else quoted_text(str(value))


def as_text(value: object) -> str:
    """Read a text without control characters."""
    if not isinstance(value, str):
        raise ValueError(f"{shown(value)} is not a text")
    if sentence := control_character(value):
        raise ValueError(sentence)
    return str(value)


def as_number(value: object) -> object:
    """Return the value of a scalar besides the text; numbers are finite and exact."""
    if not isinstance(value, Written):
        return value
    number = value.value
    if isinstance(number, float) and (not math.isfinite(number) or value.lstrip("-+").isdigit()):
        raise ValueError(f"{shown(value)} is not a finite number of at most 20 digits")
    return number


def as_whole(value: object) -> int:
    """Read a whole number."""
    number = as_number(value)
    if isinstance(number, bool) or not isinstance(number, int):
        raise ValueError(f"{shown(value)} is not a whole number")
    return number


def as_truth(value: object) -> bool:
    """True or false."""
    truth = as_number(value)
    if not isinstance(truth, bool):
        raise ValueError(f"{shown(value)} is neither true nor false")
    return truth


def as_plain(value: object) -> object:
    """Read a value as plain data."""
    if isinstance(value, dict):
        return {name: as_plain(child) for name, child in value.items()}
    if isinstance(value, list):
        return [as_plain(child) for child in value]
    return as_number(value)


def as_mapping(value: object) -> dict[str, object]:
    """Read a mapping; nothing is the empty one."""
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise ValueError(f"{shown(value)} is not a mapping (key: value)")
    return value


def as_fields(value: object) -> dict[str, object]:
    """Read fields of a message or values by name, as plain data."""
    return {name: as_plain(child) for name, child in as_mapping(value).items()}


def as_list(value: object) -> list[object]:
    """Read a list; a single value is a list of one."""
    if isinstance(value, dict):
        raise ValueError("a mapping is not a list")
    if value is None:
        return []
    return value if isinstance(value, list) else [value]


def as_arcs(value: object) -> dict[str, object]:
    """Read ``a``, ``[a, b]`` or ``{a: 2}`` as places with weights."""
    if isinstance(value, dict):
        return value
    weights: dict[str, int] = {}
    for rank, element in enumerate(as_list(value)):
        if not isinstance(element, str):
            raise FieldError((rank,), f"{shown(element)} is not a text")
        weights[str(element)] = weights.get(str(element), 0) + 1
    return dict(weights)
