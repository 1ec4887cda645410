"""Size checks before work in the parameter services of rclpy: too long requests are refused by length."""

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.type_support import check_for_type_support

from im_core.ros.conversion import Sequence, converted_by, converter

MOST_NAMES = 1000
"""Parameters, or names of some, in a request; elements of all lists in it."""
MOST_CHARACTERS = 100_000
"""Of all names and texts in a request."""


@dataclass(frozen=True)
class TooLong:
    """Request refused without a further look.

    Attributes:
        sentence: What is too long.
    """

    sentence: str


class _Parameter(ctypes.Structure):
    """``rcl_interfaces/msg/Parameter`` in C: a name, and a value of each type."""

    _fields_ = (
        ("name", Sequence),
        ("type", ctypes.c_uint8),
        ("bool_value", ctypes.c_bool),
        ("integer_value", ctypes.c_int64),
        ("double_value", ctypes.c_double),
        ("string_value", Sequence),
        ("byte_array_value", Sequence),
        ("bool_array_value", Sequence),
        ("integer_array_value", Sequence),
        ("double_array_value", Sequence),
        ("string_array_value", Sequence),
    )


_LISTS = ("byte_array_value", "bool_array_value", "integer_array_value", "double_array_value", "string_array_value")


class _Size:
    """Counter of a request's contents, up to the limit."""

    def __init__(self) -> None:
        self._items = self._characters = 0

    def texts(self, texts: Sequence) -> str:
        """Return the excess after counting the texts; empty: none."""
        if why := self.items(texts.size):
            return why
        characters = (Sequence * texts.size).from_address(texts.data) if texts.size else ()
        return self.characters(sum(text.size for text in characters))

    def items(self, count: int) -> str:
        """Return the excess with the given number of names or elements added; empty: none."""
        self._items += count
        return f"{self._items} names and elements, {MOST_NAMES} are allowed" if self._items > MOST_NAMES else ""

    def characters(self, count: int) -> str:
        """Return the excess with the given number of characters added; empty: none."""
        self._characters += count
        too_many = self._characters > MOST_CHARACTERS
        return f"{self._characters} characters, {MOST_CHARACTERS} are allowed" if too_many else ""


def _names_too_long(address: int) -> str:
    return _Size().texts(Sequence.from_address(address))


def _parameters_too_long(address: int) -> str:
    parameters, size = Sequence.from_address(address), _Size()
    if why := size.items(parameters.size):
        return why
    for parameter in (_Parameter * parameters.size).from_address(parameters.data) if parameters.size else ():
        why = size.characters(parameter.name.size + parameter.string_value.size)
        why = why or size.items(sum(getattr(parameter, name).size for name in _LISTS[:-1]))
        if why := why or size.texts(parameter.string_array_value):
            return why
    return ""


def _refuse_all(refused: TooLong, response: Any) -> None:
    """Leave the response empty, as rclpy answers a request for an unknown parameter."""


def _refuse_each(refused: TooLong, response: Any) -> None:
    response.results = [SetParametersResult(successful=False, reason=refused.sentence)]


def _refuse_together(refused: TooLong, response: Any) -> None:
    response.result = SetParametersResult(successful=False, reason=refused.sentence)


_SERVICES: Mapping[Any, tuple[Callable[[int], str], Callable[[TooLong, Any], None]]] = {
    DescribeParameters: (_names_too_long, _refuse_all),
    GetParameters: (_names_too_long, _refuse_all),
    GetParameterTypes: (_names_too_long, _refuse_all),
    ListParameters: (_names_too_long, _refuse_all),
    SetParameters: (_parameters_too_long, _refuse_each),
    SetParametersAtomically: (_parameters_too_long, _refuse_together),
}


def bounded(srv_type: Any, callback: Callable[[Any, Any], Any]) -> tuple[Any, Callable[[Any, Any], Any]]:
    """Return type and callback of a service; for parameters, too long requests are refused.

    A request to set parameters is told why; what asks for values or names gets none.
    """
    if srv_type not in _SERVICES:
        return srv_type, callback
    refuse = _SERVICES[srv_type][1]

    def answer(request: Any, response: Any) -> Any:
        if not isinstance(request, TooLong):
            return callback(request, response)
        refuse(request, response)
        return response

    return _looked_at(srv_type), answer


@cache
def _looked_at(srv_type: Any) -> Any:
    """Return a type with requests checked before the conversion to objects."""
    check_for_type_support(srv_type)
    too_long, whole = _SERVICES[srv_type][0], converter(srv_type.Request)

    def convert(address: int) -> Any:
        why = too_long(address)
        return TooLong(f"The request has {why}.") if why else whole(address)

    members = {"Request": converted_by(srv_type.Request, convert), "__module__": srv_type.__module__}
    return type(srv_type)(srv_type.__name__, (srv_type,), members)
