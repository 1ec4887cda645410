"""Description of a command of the Dispatcher, and the functions of several together."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from im_core.errors import ConfigError
from im_dispatcher.report import StepTimes
from im_pnt.execution.functions import Functions
from im_pnt.execution.jobs import Job
from im_pnt_node.rerun.host import Host

ValueT = TypeVar("ValueT")


@dataclass(frozen=True)
class CommandDescription:
    """One net of the Dispatcher with all the functions, described by a module of :mod:`im_dispatcher.commands`.

    Attributes:
        net: The net file; the symbols that it reads are the commands.
        functions: Makes its actions, enabling functions, and what to ask about actions in doubt, for a node or its
            stand-in, with the times of its steps.
        standing: For symbols, what says how far a running command is.
    """

    net: Path
    functions: Callable[[Host, StepTimes], Functions]
    standing: Mapping[str, Callable[[Job], str]] = field(default_factory=dict)


def joined(parts: Iterable[Functions]) -> Functions:
    """The functions of several commands together.

    Raises:
        ConfigError: Two commands have a function of the same name; the net that names it could get the wrong one.
    """
    whole = Functions()
    for part in parts:
        _enter(whole.actions, part.actions)
        _enter(whole.guards, part.guards)
        _enter(whole.asks, part.asks)
    return whole


def _enter(known: dict[str, ValueT], added: Mapping[str, ValueT]) -> None:
    for name, function in added.items():
        if known.setdefault(name, function) is not function:
            raise ConfigError(f"two commands of the Dispatcher have a function '{name}'", function=name)
