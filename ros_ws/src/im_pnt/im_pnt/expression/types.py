"""Types of values: JSON types, and message types, with the fields from a lookup."""

import enum
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Protocol

from im_core.plugins import extensions
from im_pnt.model.arguments import Argument, ArgumentType


class ValueKind(enum.Enum):
    """Kind of a value."""

    ANY = "anything"
    BOOLEAN = "true or false"
    INTEGER = "a whole number"
    NUMBER = "a number"
    TEXT = "a text"
    LIST = "a list"
    MESSAGE = "a message"


_MANY = {
    ValueKind.BOOLEAN: "truth values",
    ValueKind.INTEGER: "whole numbers",
    ValueKind.NUMBER: "numbers",
    ValueKind.TEXT: "texts",
}


@dataclass(frozen=True, slots=True)
class ValueType:
    """The type of a value.

    Attributes:
        kind: What it is; ANY is known only when it is there.
        element: Of a list: the type of its elements.
        message: Of a message: its type, ``package/msg/Type``.
        lowest: Of a whole number: the least that is allowed.
        highest: Likewise the greatest.
        length: Of a list: how many elements it must have; None: any number.
        longest: Of a list or text: how many elements or characters it may have; None: any number.
    """

    kind: ValueKind
    element: "ValueType | None" = None
    message: str = ""
    lowest: int | None = None
    highest: int | None = None
    length: int | None = None
    longest: int | None = None

    def __str__(self) -> str:
        if self.kind is ValueKind.MESSAGE:
            return self.message
        if self.kind is ValueKind.LIST:
            count = self.length if self.length is not None else f"at most {self.longest}" if self.longest else ""
            return f"a list of {count} {self.of()}".replace("  ", " ")
        if self.kind is ValueKind.INTEGER and self.lowest is not None:
            return f"a whole number from {self.lowest} to {self.highest}"
        if self.kind is ValueKind.TEXT and self.longest is not None:
            return f"a text of at most {self.longest} characters"
        return str(self.kind.value)

    def of(self) -> str:
        """Return the type of a list's elements."""
        if self.element is None or self.element.kind is ValueKind.ANY:
            return "values"
        return _MANY.get(self.element.kind, str(self.element))

    @property
    def is_number(self) -> bool:
        """Whether the value is a number, or may be one."""
        return self.kind in (ValueKind.NUMBER, ValueKind.INTEGER, ValueKind.ANY)

    def fits(self, wanted: "ValueType") -> bool:
        """Return whether a value of the type may stand for another, as far as types tell."""
        if ValueKind.ANY in (self.kind, wanted.kind):
            return True
        if wanted.kind is ValueKind.NUMBER:
            return self.is_number
        if self.kind is not wanted.kind:
            return False
        if self.kind is ValueKind.LIST:
            known = self.length is not None and wanted.length is not None
            if (known and self.length != wanted.length) or self.element is None or wanted.element is None:
                return False
            return self.element.fits(wanted.element)
        return self.message == wanted.message


ANY = ValueType(ValueKind.ANY)
BOOLEAN = ValueType(ValueKind.BOOLEAN)
INTEGER = ValueType(ValueKind.INTEGER)
NUMBER = ValueType(ValueKind.NUMBER)
TEXT = ValueType(ValueKind.TEXT)


def list_of(element: ValueType, length: int | None = None, longest: int | None = None) -> ValueType:
    """Return the type of lists."""
    return ValueType(ValueKind.LIST, element, length=length, longest=longest)


def message_type(name: str) -> ValueType:
    """Return the type of messages of a type, ``package/msg/Type``."""
    return ValueType(ValueKind.MESSAGE, message=name)


class MessageTypes(Protocol):
    """Looks up the fields of messages."""

    def fields(self, message: str) -> Mapping[str, ValueType] | None:
        """Return the types of the fields of a message.

        Args:
            message: ``package/msg/Type``, or ``package/srv/Type_Request``, ``package/action/Type_Result`` and so on.

        Returns:
            Types by field; None where types of messages are not known here.

        Raises:
            ImError: There is no such type.
        """


class NoTypes:
    """Lookup without any type of a message: every field may have any type."""

    def fields(self, message: str) -> Mapping[str, ValueType] | None:
        """Return no types."""
        del message
        return None


def argument_type(argument: Argument) -> ValueType:
    """Return the type of an argument's values."""
    one = {
        ArgumentType.BOOLEAN: BOOLEAN,
        ArgumentType.INTEGER: INTEGER,
        ArgumentType.NUMBER: NUMBER,
        ArgumentType.STRING: TEXT,
        ArgumentType.OBJECT: ANY,
    }[argument.type.element]
    if not argument.type.is_list:
        return one
    least, most = argument.length or (0, None)
    return list_of(one, length=least if least == most else None)


_LIST = re.compile(r"sequence<(?P<of>.+?)(?:, *(?P<most>\d+))?>|(?P<array>.+)\[(?P<length>\d+)\]")
_BOUNDED_TEXT = re.compile(r"w?string<(\d+)>")
_WHOLE = re.compile(r"(u?)int(8|16|32|64)")


def field_type(text: str) -> ValueType:
    """Return the type of a field as ROS writes types: ``double``, ``sequence<geometry_msgs/Pose, 3>``, ``uint8[4]``."""
    if match := _LIST.fullmatch(text):
        if match["array"]:
            return list_of(field_type(match["array"]), length=int(match["length"]))
        return list_of(field_type(match["of"]), longest=int(match["most"]) if match["most"] else None)
    if match := _WHOLE.fullmatch(text):
        bits = int(match[2])
        lowest, highest = (0, 2**bits - 1) if match[1] else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        return ValueType(ValueKind.INTEGER, lowest=lowest, highest=highest)
    if match := _BOUNDED_TEXT.fullmatch(text):
        return ValueType(ValueKind.TEXT, longest=int(match[1]))
    if text in ("float", "double", "long double"):
        return NUMBER
    if "/" in text:
        package, _, name = text.partition("/")
        return message_type(text if "/" in name else f"{package}/msg/{name}")
    return {"boolean": BOOLEAN, "string": TEXT, "wstring": TEXT}.get(text, ANY)


@cache
def installed_types() -> MessageTypes:
    """Return the types of the installed messages; without ROS none is known."""
    try:
        makers = list(extensions("im_pnt.message_types"))
    except ModuleNotFoundError:
        return NoTypes()
    types: MessageTypes = makers[0]() if makers else NoTypes()
    return types
