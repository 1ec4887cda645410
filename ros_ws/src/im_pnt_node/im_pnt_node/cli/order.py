"""Command of a command line: the symbol, and the arguments each as ``name=value``."""

from collections.abc import Sequence

from im_core.errors import ConfigError, NotFoundError
from im_core.text.jsontext import JsonError, decode_json
from im_pnt.model.arguments import ArgumentSchema, ArgumentType
from im_pnt.model.net import Net


class Order:
    """Command for one run."""

    def __init__(self, symbol: str, arguments: dict[str, object]) -> None:
        self.symbol, self.arguments = symbol, arguments

    @classmethod
    def read(cls, nets: Sequence[Net], symbol: str, given: Sequence[str]) -> "Order":
        """Read a command line.

        Args:
            nets: The nets, one of which knows the command.
            symbol: Its symbol.
            given: Its arguments, each ``name=value``.

        Raises:
            NotFoundError: No net knows the symbol.
            DataError: The arguments are not what the net declares.
            ConfigError: One is not of the form ``name=value``, or is given twice.
        """
        net = next((net for net in nets if symbol in net.symbols()), None)
        if net is None:
            known = [name for each in nets for name in each.symbols()]
            raise NotFoundError(kind="command", name=symbol, known=known)
        schema = net.commands[symbol].arguments if symbol in net.commands else None
        arguments: dict[str, object] = {}
        for text in given:
            name, sign, value = text.partition("=")
            if not sign or not name:
                raise ConfigError(f"argument '{text}' is not of the form name=value")
            if name in arguments:
                raise ConfigError(f"argument '{name}' is given twice")
            arguments[name] = _value(name, value, schema)
        return cls(symbol, arguments if schema is None else schema.check(arguments, f"command {symbol}"))


def _value(name: str, text: str, schema: ArgumentSchema | None) -> object:
    """Return the value of an argument: a text where declared so, else JSON, else the bare text; ``1,2`` is a list."""
    argument = None if schema is None else schema.arguments.get(name)
    if argument is not None and argument.type is ArgumentType.STRING:
        return text
    if argument is not None and argument.type is ArgumentType.STRINGS and not text.startswith("["):
        return text.split(",")
    bare = argument is not None and argument.type.is_list and not text.startswith("[")
    try:
        return decode_json(f"[{text}]" if bare else text)
    except JsonError:
        return text
