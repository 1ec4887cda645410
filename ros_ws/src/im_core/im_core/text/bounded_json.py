"""Reading of data in messages from any sender, in one way: JSON texts, and numbers standing for names.

Types of messages say ``string`` and ``uint8``; what may stand in them is checked here, once, where it enters.
"""

from collections.abc import Hashable
from enum import IntEnum
from functools import lru_cache
from typing import Any, TypeVar, cast

import pydantic

from im_core.config import field_name
from im_core.errors import DataError
from im_core.text.jsontext import JsonError, check_keys

#: Characters of a text that is read; a net of 1,000 places has 50,000.
LARGEST = 2_000_000

T = TypeVar("T")
EnumT = TypeVar("EnumT", bound=IntEnum)


def read_json(kind: type[T], text: str, what: str) -> T:
    """Read JSON of a certain form.

    Args:
        kind: The form: a model, or a type such as ``dict[str, bool]``.
        text: JSON.
        what: What it is, for complaints.

    Raises:
        DataError: It is too long, no JSON, has a key twice, is nested too deeply, or of another form.
    """
    if len(text) > LARGEST:
        raise DataError(f"{what} has {len(text)} characters; {LARGEST} are read", what=what)
    try:
        check_keys(text)
        value: T = _reader(cast(Hashable, kind)).validate_json(text, strict=True)
    except JsonError as error:
        raise DataError(f"{what} cannot be read: {error.sentence}", what=what) from error
    except pydantic.ValidationError as error:
        raise _refused(error, what) from error
    return value


def read_data(kind: type[T], data: object, what: str) -> T:
    """Read data of a certain form from decoded JSON; arguments and errors as of :func:`read_json`."""
    try:
        value: T = _reader(cast(Hashable, kind)).validate_python(data, strict=True)
    except pydantic.ValidationError as error:
        raise _refused(error, what) from error
    return value


def member(kind: type[EnumT], number: int, what: str) -> EnumT:
    """Return the member of an enumeration for a number.

    Raises:
        DataError: None has it; the message lists those that exist.
    """
    try:
        return kind(number)
    except ValueError:
        known = ", ".join(f"{each.value} {each.name}" for each in kind)
        raise DataError(f"{what} {number} does not exist; there are {known}", what=what, value=number) from None


def _refused(error: pydantic.ValidationError, what: str) -> DataError:
    """Return the error naming the first wrong field, the allowed values, and the given value."""
    first = error.errors(include_url=False)[0]
    place, words = field_name(first["loc"]), first["msg"].removeprefix("Value error, ")
    if place:
        words = f"{place}: {words}"
        if first["type"] not in ("missing", "extra_forbidden"):
            words += f", not {first['input']!r:.60}"
    return DataError(f"{what} cannot be read: {words}", what=what, field=place)


@lru_cache(maxsize=100)
def _reader(kind: Hashable) -> pydantic.TypeAdapter[Any]:
    form: Any = kind
    return pydantic.TypeAdapter(form)
