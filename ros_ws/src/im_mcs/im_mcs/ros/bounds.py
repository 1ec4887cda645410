"""Size checks: the largest allowed message, checked before any work with the message."""

import math
from collections.abc import Sequence
from typing import Any

from im_core.errors import DataError
from im_mcs.protocol.requests import LARGEST, LONGEST_TEXT

MOST_VALUES = 64
"""Names or numbers in a list, e.g. one of each joint."""


def check_bounds(message: Any, most_items: int) -> None:
    """Check every text, number and list of a message, the inner ones too; lists by the length first.

    What is in a list may be NaN or infinite here: whoever knows what it stands for says so by the joint's name.

    Args:
        message: Of ROS: a request, a goal, a message of a topic.
        most_items: Messages in a list, e.g. points of a path.

    Raises:
        DataError: A text or a list is too long, or a number is not finite or too large; field and bound are named, the
            text is not repeated.
    """
    _Bounds(most_items).check_fields(message, "", listed=False)


def check_length(value: Sequence[Any], name: str, most: int, what: str = "values") -> None:
    """Check the length of a text or a list.

    Args:
        value: The text or the list.
        name: Its field, for the error.
        most: How many elements are allowed.
        what: What its elements are, for the error.

    Raises:
        DataError: It is longer; field, length and bound are named.
    """
    if len(value) > most:
        raise DataError(f"{name} has {len(value)} {what}, {most} are allowed", field=name, length=len(value))


class _Bounds:
    def __init__(self, most_items: int) -> None:
        self._most_items = most_items

    def check_fields(self, message: Any, place: str, listed: bool) -> None:
        for name in message.get_fields_and_field_types():
            self._check(getattr(message, name), f"{place}{name}", listed)

    def _check(self, value: Any, name: str, listed: bool) -> None:
        match value:
            case bool() | int():
                return
            case str():
                check_length(value, name, LONGEST_TEXT, "characters")
            case float():
                if not listed or math.isfinite(value):
                    _check_number(value, name)
            case _ if hasattr(value, "get_fields_and_field_types"):
                self.check_fields(value, f"{name}.", listed)
            case _:
                self._check_list(value, name)

    def _check_list(self, values: Sequence[Any], name: str) -> None:
        of_messages = len(values) > 0 and hasattr(values[0], "get_fields_and_field_types")
        check_length(values, name, self._most_items if of_messages else MOST_VALUES)
        for rank, value in enumerate(values):
            self._check(value, f"{name}[{rank}]", listed=True)


def _check_number(value: float, name: str) -> None:
    if not math.isfinite(value):
        raise DataError(f"{name} is {value}, not a finite number", field=name)
    if abs(value) > LARGEST:
        raise DataError(f"{name} is {value:g}, not between {-LARGEST:g} and {LARGEST:g}", field=name)
