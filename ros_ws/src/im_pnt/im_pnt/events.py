"""What happens to a net, and what a net tells of itself."""

import enum
from dataclasses import dataclass

from im_core.errors import ImError
from im_pnt.jobs import Activity, Job, Lineage, Request


class Phase(enum.IntEnum):
    """Phase of a firing, numbered as in ``im_msgs/msg/Firing``. Instantaneous transitions have an END only."""

    START = 0
    END = 1
    FAILED = 2


@dataclass(frozen=True, slots=True)
class Firing:
    """One firing of the expanded net.

    Attributes:
        net: Name of the net.
        transition: Transition as written, or the one of a coordination structure (``accept.s``, ``t_f.s``, ...).
        sequence: Counts the firings of the net from 1.
        phase: What happened.
        symbol: Symbol read from the tape, or the first one written to it; empty if none.
        command_id: Command it was done for, 0 if none.
        message: Why it failed.
        duration: Wall time since START [s], 0 for instantaneous transitions.
        progress: Progress of the command 0..1, negative where unknown.
    """

    net: str
    transition: str
    sequence: int
    phase: Phase
    symbol: str
    command_id: int
    message: str
    duration: float
    progress: float


@dataclass(frozen=True, slots=True)
class CommandWritten:
    """A command arrives on the input tape."""

    job: Job


@dataclass(frozen=True, slots=True)
class CommandCancelled:
    """A command, or everything if the number is None, should end early; ``error`` says why."""

    command_id: int | None
    error: ImError


@dataclass(frozen=True, slots=True)
class RequestArrived:
    """A request arrives at a service."""

    request: Request


@dataclass(frozen=True, slots=True)
class RequestCancelled:
    """The caller of a request does not want it any more, or is gone; ``error`` says which."""

    request_id: str
    error: ImError


@dataclass(frozen=True, slots=True)
class TokenArrived:
    """Tokens of another net arrive."""

    place: str
    count: int


@dataclass(frozen=True, slots=True)
class ActionEnded:
    """An action has confirmed, or failed with ``error``."""

    activity: Activity
    error: ImError | None
    results: dict[str, object]


@dataclass(frozen=True, slots=True)
class ObjectInvalidated:
    """A data object has lost its validity."""

    name: str


@dataclass(frozen=True, slots=True)
class GuardsChanged:
    """Something that guards look at may have changed."""


Event = (
    CommandWritten
    | CommandCancelled
    | RequestArrived
    | RequestCancelled
    | TokenArrived
    | ActionEnded
    | ObjectInvalidated
    | GuardsChanged
)


class Observer:
    """Is told what a net does; does nothing with it. Override what is of interest."""

    def fired(self, firing: Firing) -> None:
        """Called after each firing, before the action it starts."""

    def progressed(self, net: str, job: Job | None, text: str, fraction: float) -> None:
        """Called when an action reports progress; from whatever thread it does."""

    def emitted(self, net: str, symbol: str, lineage: Lineage) -> None:
        """Called for each symbol written to the output tape."""

    def troubled(self, net: str, text: str) -> None:
        """Called for what should be in a log: refused tokens, late completions, guards that fail."""
