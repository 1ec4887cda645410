"""Fields of a data set as arrays; what is wrong in one is named by its place, such as ``trials[2].u_px[0][17]``."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError

Array = NDArray[np.float64]

ANY = -1
"""A length that the data choose."""


def field(content: object, key: str, place: str = "") -> Any:
    """A field of an object.

    Args:
        content: The object as read from JSON.
        key: Name of the field.
        place: Where the object stands in the file; empty: it is the file.

    Raises:
        DataError: It is no object, or has no such field.
    """
    if not isinstance(content, Mapping):
        raise DataError(f"{place or 'the data set'} is {_kind(content)}, an object with the field {key!r} is needed.")
    if key not in content:
        raise DataError(f"{place or 'the data set'} has no field {key!r}.", field=key)
    return content[key]


def array(value: object, shape: tuple[int, ...], place: str, *, holes: bool = False) -> Array:
    """Nested lists as an array.

    Args:
        value: The lists.
        shape: Lengths from the outside in; :data:`ANY` where the first list met decides.
        place: Where the value stands in the file.
        holes: Whether the innermost lists may be null; they become NaN.

    Raises:
        DataError: A list is missing or has the wrong length, or an element is no finite number; the place is named.
    """
    lengths = list(shape)
    numbers: list[float] = []
    _collect(value, lengths, 0, place, holes, numbers)
    return np.array(numbers, dtype=float).reshape([max(length, 0) for length in lengths])


def scalar(value: object, place: str) -> float:
    """A finite number.

    Raises:
        DataError: It is none.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise DataError(f"{place} is {_kind(value)}, a number is needed.", field=place)
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number) or abs(number) > 1e12:
        raise DataError(f"{place} is {number:g}, a finite number of sensible size is needed.", field=place)
    return number


def _collect(value: object, lengths: list[int], depth: int, place: str, holes: bool, numbers: list[float]) -> None:
    if depth == len(lengths):
        numbers.append(scalar(value, place))
        return
    innermost = depth == len(lengths) - 1
    if value is None and holes and innermost and lengths[depth] != ANY:
        numbers += [math.nan] * lengths[depth]
        return
    if not isinstance(value, list):
        wanted = "a list" if lengths[depth] == ANY else f"a list of {lengths[depth]}"
        wanted += " or null" * (holes and innermost)
        raise DataError(f"{place} is {_kind(value)}, {wanted} is needed.", field=place)
    if lengths[depth] == ANY:
        lengths[depth] = len(value)
    if len(value) != lengths[depth]:
        raise DataError(f"{place} has {len(value)} elements, {lengths[depth]} are needed.", field=place)
    for i, element in enumerate(value):
        _collect(element, lengths, depth + 1, f"{place}[{i}]", holes, numbers)


def _kind(value: object) -> str:
    names = {dict: "an object", list: "a list", str: "a text", bool: "a truth value", type(None): "null"}
    return names.get(type(value), "a number")
