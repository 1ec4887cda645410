"""Commands of the Dispatcher on a command line: options, help and values from the schema of the arguments."""

import argparse
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NoReturn

from im_core.errors import NotFoundError, StateError, nearest
from im_core.options import NumberParser, between, finite_number, shown, whole

Schema = Mapping[str, Any]
"""JSON schema of an argument, or of all arguments of a command."""


class CommandParser(NumberParser):
    """The options of one command.

    Args:
        told: What the Dispatcher tells of the command on ``/dispatcher/commands``.
    """

    def __init__(self, told: Mapping[str, Any]) -> None:
        self._schema: Schema = told.get("arguments", {})
        needs = ", ".join(re.sub(r"\$\{arguments\.(\w+)\}", r"<\1>", need) for need in told.get("needs", ()))
        holds = f"Needs {needs}; where others hold that, it {_BUSY[told['busy']]}." if needs else None
        super().__init__(
            prog=f"im run {told['symbol']}",
            description=told.get("description"),
            epilog=holds,
            allow_abbrev=False,
            add_help=False,
        )
        properties: Mapping[str, Schema] = self._schema.get("properties", {})
        priority, as_json, self._help = _own_options(properties)
        self.add_argument("-h", self._help, action="help", help="show this help message and exit")
        self._names: dict[str, str] = {}
        for name, schema in properties.items():
            self._add(name, schema, name in self._schema.get("required", ()))
        add = self.add_argument_group("of every command").add_argument
        add(
            priority,
            dest="priority",
            type=between(-10, 10),
            default=0,
            metavar="N",
            help="-10 to 10, added to the command's own",
        )
        add(as_json, dest="json", action="store_true", help="print the results as JSON; progress goes to stderr")
        if "arguments" not in told:
            self.add_argument("--arguments", type=json_object, default={}, metavar="JSON", help="a JSON object")

    def read(self, texts: Sequence[str]) -> tuple[dict[str, object], argparse.Namespace]:
        """Parse the given arguments and the options common to all commands; exit the process with code 2 on error."""
        options, rest = self.parse_known_args(texts)
        if rest:
            known = [option for action in self._actions for option in action.option_strings if option != "-h"]
            self.error(f"there is no {rest[0]}{nearest(rest[0], known)}")
        given = {name: value for key, name in self._names.items() if (value := getattr(options, key)) is not None}
        return {**given, **getattr(options, "arguments", {})}, options

    def error(self, message: str) -> NoReturn:
        """Report the error in one sentence."""
        self.exit(2, f"{self.prog}: {message}; {self.prog} {self._help} tells more\n")

    def _add(self, name: str, schema: Schema, required: bool) -> None:
        options = _options(name)
        key = f"argument_{name}"
        self._names[key] = name
        is_list = schema.get("type") == "array"
        one: Schema = schema.get("items", {}) if is_list else schema
        self.add_argument(
            *options,
            dest=key,
            required=required,
            nargs="*" if is_list else None,
            type=_reader(str(one.get("type")), str(schema.get("unit", ""))),
            metavar=_metavar(one),
            help=_help(schema, one).replace("%", "%%"),
        )


def command_told(
    commands: Sequence[Mapping[str, Any]], symbol: str, left_out: Mapping[str, str] = MappingProxyType({})
) -> Mapping[str, Any]:
    """Return the Dispatcher's description of a command.

    Args:
        commands: All descriptions.
        symbol: Name of the command.
        left_out: Why the cell has no such command, by the command's name.

    Raises:
        StateError: The cell lacks a part that the command needs.
        NotFoundError: There is no such command.
    """
    for told in commands:
        if told["symbol"] == symbol:
            return told
    if symbol in left_out:
        raise StateError(f"{symbol} is left out: {left_out[symbol]}", command=symbol)
    raise NotFoundError(kind="command", name=symbol, known=[str(told["symbol"]) for told in commands])


def completions(commands: Sequence[Mapping[str, Any]]) -> str:
    """Return the names for shell completion: a line for each command, followed by options and choices."""
    lines = []
    for told in commands:
        words, properties = [str(told["symbol"])], told.get("arguments", {}).get("properties", {})
        for name, schema in properties.items():
            one = schema.get("items", schema)
            choices = one.get("enum", ["true", "false"] if one.get("type") == "boolean" else [])
            words.append(_options(name)[0] + "".join(f"={choice}" for choice in choices))
        words.extend(_own_options(properties))
        lines.append(" ".join(words))
    return "".join(f"{line}\n" for line in lines)


def json_object(text: str) -> dict[str, object]:
    """Parse a JSON object.

    Raises:
        ArgumentTypeError: It is none.
    """
    value = json_value(text)
    if not isinstance(value, dict):
        raise argparse.ArgumentTypeError(f"{shown(text)} is no JSON object")
    return value


def json_value(text: str) -> object:
    """Parse a JSON value.

    Raises:
        ArgumentTypeError: It is none.
    """
    try:
        value: object = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise argparse.ArgumentTypeError(f"{shown(text)} is no JSON: {error}") from error
    return value


def _truth(text: str) -> bool:
    if text not in ("true", "false"):
        raise argparse.ArgumentTypeError(f"{shown(text)} is not true or false")
    return text == "true"


def _reader(kind: str, unit: str) -> Callable[[str], object]:
    """Return the reader of a value; a number may be followed by its unit, also with a prefix: ``0.3mm``."""
    if kind != "number" or not unit.isalpha():
        return _READERS.get(kind, json_value)

    def quantity(text: str) -> float:
        number = text.removesuffix(unit)
        prefix = number[-1:] if number != text and number[-1:] in _PREFIXES else ""
        try:
            return finite_number(number.removesuffix(prefix)) * _PREFIXES.get(prefix, 1.0)
        except argparse.ArgumentTypeError as error:
            raise argparse.ArgumentTypeError(f"{shown(text)} is not a finite number [{unit}]") from error

    return quantity


_PREFIXES: Mapping[str, float] = {"u": 1e-6, "m": 1e-3, "c": 1e-2}
_READERS: Mapping[str, Callable[[str], object]] = {
    "boolean": _truth,
    "integer": whole,
    "number": finite_number,
    "string": str,
}
_OWN = ("--priority", "--json", "--help")
_BUSY = {"wait": "waits", "refuse": "is refused"}


def _options(name: str) -> list[str]:
    """How an argument can be written, the usual way first."""
    return list(dict.fromkeys(["--" + name.replace("_", "-"), f"--{name}"]))


def _own_options(arguments: Iterable[str]) -> list[str]:
    """Return the options common to all commands; one with the name of an argument gets the prefix ``--run-``."""
    taken = {option for name in arguments for option in _options(name)}
    own = []
    for option in _OWN:
        while option in taken:
            option = f"--run-{option.removeprefix('--')}"
        own.append(option)
    return own


def _metavar(schema: Schema) -> str:
    if "enum" in schema:
        return "|".join(str(choice) for choice in schema["enum"])
    return {"string": "TEXT", "boolean": "true|false", "integer": "N", "number": "X"}.get(
        str(schema.get("type")), "JSON"
    )


def _help(schema: Schema, one: Schema) -> str:
    parts = [str(schema["description"])] if "description" in schema else []
    low, high, unit = one.get("minimum"), one.get("maximum"), schema.get("unit")
    if low is not None or high is not None:
        parts.append(f"{'' if low is None else f'{low:g}'}..{'' if high is None else f'{high:g}'}")
    if unit:
        parts.append(f"[{unit}]")
    least, most = schema.get("minItems"), schema.get("maxItems")
    if most is not None:
        parts.append(f"({most} values)" if least == most else f"({least} to {most} values)")
    if schema.get("default") not in (None, "", []):
        parts.append(f"(default: {json.dumps(schema['default'])})")
    return " ".join(parts)
