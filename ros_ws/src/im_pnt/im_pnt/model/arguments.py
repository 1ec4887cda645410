"""Arguments of a command or a service: names with types, units, limits and defaults, with one check for all."""

import enum
import math
from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass, field, replace

from im_core.errors import ArgumentError, DataError, nearest, quoted_text, require_text


class ArgumentType(enum.StrEnum):
    """Type of a value; plurals are lists."""

    BOOLEAN = "boolean"
    INTEGER = "integer"
    NUMBER = "number"
    STRING = "string"
    BOOLEANS = "booleans"
    INTEGERS = "integers"
    NUMBERS = "numbers"
    STRINGS = "strings"
    OBJECT = "object"

    @property
    def is_list(self) -> bool:
        """Whether the values are lists."""
        return self is not ArgumentType.OBJECT and self.endswith("s")

    @property
    def element(self) -> "ArgumentType":
        """Type of an element of a list; without a list, the same type."""
        return ArgumentType(self[:-1]) if self.is_list else self

    @property
    def is_numeric(self) -> bool:
        """Whether the values, or the elements, are numbers."""
        return self.element in (ArgumentType.INTEGER, ArgumentType.NUMBER)


_NOUNS = {
    ArgumentType.BOOLEAN: ("true or false", "truth values"),
    ArgumentType.INTEGER: ("a whole number", "whole numbers"),
    ArgumentType.NUMBER: ("a number", "numbers"),
    ArgumentType.STRING: ("a text", "texts"),
    ArgumentType.OBJECT: ("any JSON", "any JSON"),
}
_LARGEST = 2**63


@dataclass(frozen=True, slots=True)
class Argument:
    """One argument.

    Attributes:
        name: Its name.
        type: What its value may be.
        unit: Unit of its numbers, ISO notation without brackets; empty: none.
        minimum: Least number, also of each element of a list; None: no limit.
        maximum: Greatest number, likewise.
        choices: What the value, or each element of a list, is one of; empty: anything.
        length: Least and greatest number of elements of a list, or of characters of a text; None: any.
        required: Whether it must be given.
        default: Its value where it is not given.
        help: One line for people.
    """

    name: str
    type: ArgumentType
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[object, ...] = ()
    length: tuple[int, int] | None = None
    required: bool = True
    default: object = None
    help: str = ""

    def allowed(self) -> str:
        """Return the allowed values in words: ``a number from 0 to 0.1 [m]``."""
        one, many = _NOUNS[self.type.element]
        words = one
        if self.length is not None and not self.type.is_list:
            words = f"{one} of {_count(self.length)} characters"
        elif self.type.is_list:
            words = f"a list of {_count(self.length)} {many}" if self.length is not None else f"a list of {many}"
        if self.choices:
            words = f"one of {', '.join(map(_shown, self.choices))}"
            words = f"a list of {words}" if self.type.is_list else words
        if self.minimum is not None and self.maximum is not None:
            words += f" from {self.minimum:g} to {self.maximum:g}"
        elif self.minimum is not None:
            words += f" >= {self.minimum:g}"
        elif self.maximum is not None:
            words += f" <= {self.maximum:g}"
        return f"{words} [{self.unit}]" if self.unit else words

    def check(self, value: object) -> object:
        """Check a value; a tuple becomes a list.

        Raises:
            ArgumentError: It is not what is allowed; says what it is, and what is allowed.
            DataError: A text has half a character.
        """
        if self.type is ArgumentType.OBJECT:
            return value
        if not self.type.is_list:
            self._check_one(value, self.name)
            return value
        if not isinstance(value, list | tuple):
            raise self._refusal(self.name, value)
        self._check_length(value, self.name)
        one = replace(self, type=self.type.element, length=None)
        for index, element in enumerate(value):
            one._check_one(element, f"{self.name}[{index}]")
        return list(value)

    def limits(self) -> dict[str, float]:
        """Return the minimum and maximum, where declared, by the names ``minimum`` and ``maximum``."""
        limits = {"minimum": self.minimum, "maximum": self.maximum}
        return {key: limit for key, limit in limits.items() if limit is not None}

    def json_schema(self) -> dict[str, object]:
        """Return the JSON schema of the value, with ``unit`` beside the keys of the standard."""
        one: dict[str, object] = {} if self.type is ArgumentType.OBJECT else {"type": self.type.element.value}
        one |= self.limits()
        if self.choices:
            one["enum"] = list(self.choices)
        least, most = ("minItems", "maxItems") if self.type.is_list else ("minLength", "maxLength")
        whole: dict[str, object] = {"type": "array", "items": one} if self.type.is_list else one
        if self.length is not None:
            whole[least], whole[most] = self.length
        if self.unit:
            whole["unit"] = self.unit
        if not self.required:
            whole["default"] = self.default
        if self.help:
            whole["description"] = self.help
        return whole

    def _check_one(self, value: object, where: str) -> None:
        match self.type.element:
            case ArgumentType.BOOLEAN:
                fits = isinstance(value, bool)
            case ArgumentType.INTEGER:
                fits = isinstance(value, int) and not isinstance(value, bool) and -_LARGEST <= value < _LARGEST
            case ArgumentType.NUMBER:
                fits = isinstance(value, int | float) and not isinstance(value, bool) and _is_finite(value)
            case _:
                fits = isinstance(value, str)
        if fits and isinstance(value, str):
            require_text(value, f"a text of argument {where}")
            self._check_length(value, where)
        if fits and isinstance(value, int | float) and not isinstance(value, bool):
            low, high = self.minimum, self.maximum
            fits = (low is None or value >= low) and (high is None or value <= high)
        if not fits or (self.choices and value not in self.choices):
            raise self._refusal(where, value)

    def _check_length(self, value: str | list[object] | tuple[object, ...], where: str) -> None:
        if self.length is None:
            return
        least, most = self.length
        if not least <= len(value) <= most:
            what = "characters" if isinstance(value, str) else "elements"
            text = f"argument {where} has {len(value)} {what}, not {_count(self.length)}"
            raise ArgumentError(text, argument=self.name, value=len(value), allowed=self.allowed())

    def _refusal(self, where: str, value: object) -> ArgumentError:
        hint = ""
        if self.choices and isinstance(value, str):
            near = nearest(value, map(str, self.choices))
            hint = near if "mean" in near else ""
        text = f"argument {where} is {_shown(value)}, not {self.allowed()}{hint}"
        return ArgumentError(text, argument=self.name, value=value, allowed=self.allowed())


@dataclass(frozen=True, slots=True)
class ArgumentSchema:
    """The arguments of a command or service, by name; any other is refused."""

    arguments: Mapping[str, Argument] = field(default_factory=dict)

    def check(self, given: Mapping[str, object], what: str) -> dict[str, object]:
        """Check arguments, and fill in the missing ones.

        Args:
            given: Values by name.
            what: Whose arguments, for messages: ``command pick``.

        Returns:
            All arguments, in the order of the schema.

        Raises:
            ArgumentError: One is unknown, missing, or not what is allowed; names it, its value and what is allowed.
        """
        self.require_known(given, what)
        self.require_given(given, what)
        values: dict[str, object] = {}
        for name, argument in self.arguments.items():
            if name in given:
                try:
                    values[name] = argument.check(given[name])
                except DataError as error:
                    refused = ArgumentError(f"{what}: {error.message}")
                    refused.facts.update(error.facts)
                    raise refused from error
            else:
                default = argument.default
                values[name] = list(default) if isinstance(default, tuple | list) else default
        return values

    def require_known(self, names: Iterable[str], what: str) -> None:
        """Check whether arguments of some names are declared.

        Raises:
            ArgumentError: There is none of one of them.
        """
        for name in names:
            if name not in self.arguments:
                hint = nearest(name, self.arguments) or "; it takes none"
                raise ArgumentError(f"{what} has no argument {quoted_text(name)}{hint}", argument=name)

    def require_given(self, names: Container[str], what: str) -> None:
        """Check whether all arguments without a default are given.

        Raises:
            ArgumentError: One is not.
        """
        for name, argument in self.arguments.items():
            if argument.required and name not in names:
                about = f" ({argument.help})" if argument.help else ""
                text = f"{what}: argument {name} is missing, {argument.allowed()}{about}"
                raise ArgumentError(text, argument=name, allowed=argument.allowed())

    def json_schema(self) -> dict[str, object]:
        """Return the JSON schema of the arguments as one object."""
        return {
            "type": "object",
            "properties": {name: argument.json_schema() for name, argument in self.arguments.items()},
            "required": [name for name, argument in self.arguments.items() if argument.required],
            "additionalProperties": False,
        }


class Busy(enum.StrEnum):
    """Rule for a command in need of occupied resources."""

    WAIT = "wait"
    REFUSE = "refuse"


@dataclass(frozen=True, slots=True)
class CommandDeclaration:
    """Declaration of a command in a net: of a symbol beginning a command.

    Attributes:
        description: One line for people.
        arguments: What it takes.
        needs: Resources that it holds while it is under way; ``${arguments.NAME}`` in them stands for an argument.
        busy: Whether it waits where these are held, or is refused.
        priority: Larger goes first, where several wait for the same.
    """

    description: str = ""
    arguments: ArgumentSchema = field(default_factory=ArgumentSchema)
    needs: tuple[str, ...] = ()
    busy: Busy = Busy.WAIT
    priority: int = 0


def _is_finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _count(length: tuple[int, int]) -> str:
    least, most = length
    return str(least) if least == most else f"{least} to {most}" if least else f"at most {most}"


def _shown(value: object) -> str:
    if isinstance(value, str):
        return quoted_text(value)
    if isinstance(value, dict):
        return "a JSON object"
    if isinstance(value, list | tuple):
        return "a list"
    if value is None:
        return "nothing"
    return str(value).lower() if isinstance(value, bool) else f"{value!r:.60}"
