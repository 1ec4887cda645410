"""Parts of a command of the Dispatcher, and the view of the node."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TypeVar

from im_core.errors import ConfigError
from im_dispatcher.report import StepTimes
from im_pnt.execution.functions import Functions
from im_pnt.execution.jobs import Job
from im_pnt.model.net import Net

ValueT = TypeVar("ValueT")


class CommandHost(Protocol):
    """Node of the commands, as seen by the command functions."""

    seed: int

    @property
    def recorded(self) -> bool:
        """Whether the mission is being recorded: cached inputs are then read again."""

    async def put_object(self, name: str, value: object, place: str = "") -> None:
        """Store a data object.

        Args:
            name: Its name.
            value: A dictionary of JSON data, or of a type that :mod:`im_dispatcher.ros.host` can translate.
            place: ``net.place`` that stands for it, or empty.

        Raises:
            ImError: It was refused, or ``/dom`` does not answer.
        """

    async def get_object(self, name: str, kind: type[ValueT]) -> ValueT:
        """Return a data object; an object put by the same node costs no call.

        Raises:
            ImError: There is none that is valid, or ``/dom`` does not answer.
        """

    def noted(self, key: str, compute: Callable[[], ValueT]) -> ValueT:
        """Return a value computed from the world outside, such as a time or a folder; JSON data.

        When a mission is run again, this is what was recorded, and nothing is computed.
        """

    async def noted_apart(self, key: str, compute: Callable[..., ValueT], *arguments: object) -> ValueT:
        """Return a value computed from the world outside, in a separate thread, for slow work."""

    def time_steps(self, net: str, times: StepTimes) -> None:
        """Time the firings of a net, and of all nets required by the net."""

    def nets_for(self, net: str) -> Sequence[Net]:
        """Return a net as written, with the known nets of the services."""

    def now(self) -> float:
        """Return the testbed time [s]."""

    def warn(self, text: str) -> None:
        """Write a line to the log."""


@dataclass(frozen=True)
class CommandDescription:
    """One net of the Dispatcher with all the functions, described by a module of :mod:`im_dispatcher.commands`.

    Attributes:
        net: The net file; the symbols that it reads are the commands.
        functions: Makes its actions, enabling functions, and what to ask about actions in doubt.
        standing: For symbols, what says how far a running command is.
    """

    net: Path
    functions: Callable[[CommandHost], Functions] = lambda _: Functions()
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
