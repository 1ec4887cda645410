"""JSON values as what they should be, and sentences about what they are not."""

import math
import reprlib
import sys
from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard

from im_core.errors import DataError


def check_fields(given: Mapping[str, Any], needs: set[str], may: set[str], what: str) -> None:
    """Check the fields of an object: all that it needs, and none that it does not know.

    Raises:
        DataError: It is not.
    """
    missing, unknown = needs - given.keys(), given.keys() - needs - may
    takes = ", ".join([*sorted(needs), *(f"[{name}]" for name in sorted(may))])
    if missing:
        raise DataError(f"{what}: {', '.join(sorted(missing))} is missing; it takes {takes}")
    if unknown:
        raise DataError(f"{what}: unknown {', '.join(sorted(map(str, unknown)))}; it takes {takes}")


def as_list(value: object, what: str) -> Sequence[Any]:
    """A JSON list.

    Raises:
        DataError: It is not.
    """
    if not isinstance(value, list | tuple):
        raise DataError(f"{what}: {reprlib.repr(value)} is not a list")
    return value


def as_numbers(value: object, what: str) -> list[float]:
    """A JSON list of numbers, finite or not.

    Raises:
        DataError: It is not.
    """
    items = as_list(value, what)
    for item in items:
        if not is_real(item):
            raise DataError(f"{what}: {reprlib.repr(item)} is not a number")
    return [float(item) for item in items]


def as_amount(value: object, what: str, unit: str) -> float:
    """A finite number that is not negative.

    Raises:
        DataError: It is not.
    """
    if not is_number(value) or float(value) < 0.0:
        raise DataError(f"{what} {reprlib.repr(value)} is not a finite number >= 0 [{unit}]")
    return float(value)


def is_number(value: object) -> TypeGuard[float]:
    """Whether it is a finite number."""
    return is_real(value) and math.isfinite(value)


def is_real(value: object) -> TypeGuard[float]:
    """Whether it is a number, finite or not; JSON has whole numbers that are too large to be one."""
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) <= sys.float_info.max
    return isinstance(value, float)
