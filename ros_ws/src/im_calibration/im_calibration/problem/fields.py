"""Validators of a data set's fields: nested lists of numbers become arrays, faults are reported with the place."""

from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationInfo

from im_core.config import FieldError

Array = NDArray[np.float64]

_LARGEST_NUMBER = 1e12


class Lists:
    """Validator of nested lists of numbers, converting the lists to an array.

    Args:
        lengths: From the outside in; a letter stands for a number that the first field with that letter decides.
        holes: Whether the innermost lists may be null; they become NaN.
        optional: Whether the whole may be null.
    """

    def __init__(self, *lengths: int | str, holes: bool = False, optional: bool = False) -> None:
        self._lengths, self._holes, self._optional = lengths, holes, optional

    def __call__(self, value: object, info: ValidationInfo) -> Array | None:
        """Return the array; lists are flattened one after the other, so large data sets cost no extra time."""
        if value is None and self._optional:
            return None
        decided: dict[str, int] = info.context if info.context is not None else {}
        elements: list[Any] = [value]
        shape: list[int] = []
        empty = np.zeros(1, dtype=bool)
        for depth, length in enumerate(self._lengths):
            wanted = length if isinstance(length, int) else decided.get(length)
            or_null = self._holes and depth == len(self._lengths) - 1
            if or_null and wanted is not None:
                empty = np.repeat(np.array([element is None for element in elements], dtype=bool), wanted)
                hole = [np.nan] * wanted
                elements = [hole if element is None else element for element in elements]
            for i, element in enumerate(elements):
                if type(element) is not list:
                    a_list = "a list" + f" of {wanted}" * (wanted is not None) + " or null" * or_null
                    raise _misplaced(i, shape, f"is {kind_of(element)}, {a_list} is needed")
                if wanted is None:
                    wanted = decided[str(length)] = len(element)
                if len(element) != wanted:
                    raise _misplaced(i, shape, f"has {len(element)} elements, {wanted} are needed")
            shape.append(wanted or 0)
            elements = list(chain.from_iterable(elements))
        for kind in set(map(type, elements)):
            if kind is bool or not issubclass(kind, int | float):
                i = next(i for i, element in enumerate(elements) if type(element) is kind)
                raise _misplaced(i, shape, f"is {kind_of(elements[i])}, a number is needed")
        try:
            array = np.array(elements, dtype=float)
        except OverflowError:  # an integer that no floating-point number holds
            array = np.array([element if abs(element) < _LARGEST_NUMBER else np.inf for element in elements])
        for i in map(int, np.flatnonzero(~(np.abs(array) <= _LARGEST_NUMBER) & ~empty)):
            raise _misplaced(i, shape, f"is {array[i]:g}, a finite number of sensible size is needed")
        return array.reshape(shape)


class Names:
    """Validator of an optional list of names, as many as a letter of :class:`Lists` stands for.

    Args:
        length: The letter.
        different: Whether each may be there once.
    """

    def __init__(self, length: str, *, different: bool = True) -> None:
        self._length, self._different = length, different

    def __call__(self, names: object, info: ValidationInfo) -> tuple[str, ...] | None:
        """The names."""
        if names is None:
            return None
        if not isinstance(names, list) or not all(isinstance(name, str) and name for name in names):
            raise ValueError("must be a list of names")
        wanted = (info.context or {}).get(self._length)
        if len(names) != wanted or (self._different and len(set(names)) != len(names)):
            kind = "different names" if self._different else "names"
            raise ValueError(f"must be {wanted} {kind}, got {', '.join(names)}")
        return tuple(names)


def number(value: object, info: ValidationInfo) -> float | None:
    """Return a number, or None for null."""
    array = Lists(optional=True)(value, info)
    return None if array is None else float(array)


def positive(sigma: Array | None) -> Array | None:
    """Check standard deviations: all must be above 0 [px]; return the unchanged values."""
    if sigma is not None:
        for place in np.argwhere(sigma <= 0.0):
            raise FieldError(tuple(int(i) for i in place), f"is {sigma[tuple(place)]:g}, it must be > 0 [px]")
    return sigma


def _misplaced(number: int, shape: list[int], sentence: str) -> FieldError:
    """Return the error for one element, given by a flat index, in lists of a shape."""
    return FieldError(tuple(int(i) for i in np.unravel_index(number, shape)) if shape else (), sentence)


def kind_of(value: object) -> str:
    """Return the kind of a JSON value, in words."""
    names = {dict: "an object", list: "a list", str: "a text", bool: "a truth value", type(None): "null"}
    return names.get(type(value), "a number")
