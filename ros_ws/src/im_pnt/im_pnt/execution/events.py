"""What happens to a net, and what a net tells of itself."""

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from im_core.errors import ImError
from im_pnt.doubt import Answer
from im_pnt.jobs import Activity, Job, Lineage, Request
from im_pnt.modes import Mode


class Phase(enum.IntEnum):
    """Phase of a firing, numbered as in ``im_msgs/msg/Firing``. Instantaneous transitions have an END only.

    CANCEL: an action was asked to end early and winds down. DOUBT: nobody has said yet what became of it.
    """

    START = 0
    END = 1
    FAILED = 2
    CANCEL = 3
    DOUBT = 4


class Firing(NamedTuple):
    """One firing of the expanded net.

    Attributes:
        net: Name of the net.
        transition: Transition as written, or the one of a coordination structure (``accept.s``, ``t_f.s``, ...).
        sequence: Counts the firings of the net from 1.
        phase: What happened.
        symbol: Symbol read from the tape, or the first one written to it; empty if none.
        command_id: Command it was done for, 0 if none.
        message: Why it failed, is cancelled or in doubt.
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
class Answered:
    """The answer to the question what became of an action that is in doubt."""

    activity: Activity
    answer: Answer


@dataclass(frozen=True, slots=True)
class GuardsChanged:
    """Something that guards look at may have changed: a source as they declare it, or who knows what (empty)."""

    source: str = ""


@dataclass(frozen=True, slots=True)
class ModeSet:
    """An operator sets the mode; whatever was proposed or held back is decided about again."""

    mode: Mode


@dataclass(frozen=True, slots=True)
class PauseSet:
    """An operator has nothing new started, or everything go on."""

    paused: bool


@dataclass(frozen=True, slots=True)
class StepAsked:
    """An operator lets one transition fire (mode step)."""


@dataclass(frozen=True, slots=True)
class Confirmed:
    """An operator lets a proposed transition fire (mode supervised)."""

    transition: str


Event = (
    CommandWritten
    | CommandCancelled
    | RequestArrived
    | RequestCancelled
    | TokenArrived
    | ActionEnded
    | ObjectInvalidated
    | Answered
    | GuardsChanged
    | ModeSet
    | PauseSet
    | StepAsked
    | Confirmed
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

    def chose(
        self, net: str, places: tuple[str, ...], probabilities: Mapping[str, float], entropy: float, taken: str
    ) -> None:
        """Called for each choice among strategies, before the firing.

        Args:
            net: Name of the net.
            places: Input places of the transition taken that others contend for.
            probabilities: Of each contending transition.
            entropy: Of the choice [nats].
            taken: The transition that fires.
        """

    def operated(self, net: str, mode: Mode, paused: bool, proposed: tuple[str, ...]) -> None:
        """Called when the mode, the pause or the transitions that wait to be confirmed have changed."""
