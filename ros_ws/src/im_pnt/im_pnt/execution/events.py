"""Events of a net: the content of the inbox."""

import enum
from dataclasses import dataclass, field

from im_core.errors import ImError
from im_pnt.execution.jobs import Activity, Job, JobKey, Request, TokenContext
from im_pnt.execution.operator import Mode


class Outcome(enum.Enum):
    """Outcome of an action, in a word."""

    DONE = "done"
    FAILED = "failed"
    RUNNING = "running"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Answer:
    """Outcome of an action.

    Attributes:
        outcome: In a word.
        error: Why it failed, where it did.
        results: Results of a request that is done, or what is kept of another answer.
        asked: Who or what gave the answer, or why nobody could, for people.
    """

    outcome: Outcome
    error: ImError | None = None
    results: dict[str, object] = field(default_factory=dict)
    asked: str = ""


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
class CommandHeld:
    """Event: begin nothing more for a command (running actions end), or go on.

    Attributes:
        command_id: Its number; None: all commands, requests and tokens of jobs that are here.
        held: Whether nothing is begun.
        scope: Its scope: commands of other nodes have their own numbers. Empty: any command of that number.
    """

    command_id: int | None
    held: bool
    scope: str = ""


@dataclass(frozen=True, slots=True)
class RequestArrived:
    """A request arrives at a service.

    Attributes:
        request: The request.
        held: Whether nothing is begun for it, since the caller is paused.
    """

    request: Request
    held: bool = False


@dataclass(frozen=True, slots=True)
class RequestCancelled:
    """Event: the caller of a request has cancelled the request, or is gone; ``error`` gives the case."""

    request_id: str
    error: ImError


@dataclass(frozen=True, slots=True)
class RequestHeld:
    """Event: a request is held since the caller is paused, so nothing is begun; or the request goes on."""

    request_id: str
    held: bool


@dataclass(frozen=True, slots=True)
class TokenArrived:
    """Event: tokens of another net arrive, with the context for tokens of a job."""

    place: str
    count: int
    context: TokenContext | None = None


class JobUpdate(enum.StrEnum):
    """Update of a job, told between nets after the tokens have crossed."""

    SETTLED = "settled"
    """The work of a token that was sent is done, there and wherever it has led to."""
    CANCELLED = "cancelled"
    """The job should come to an end early."""
    HELD = "held"
    """Nothing more is begun for it."""
    RELEASED = "released"
    """It goes on."""
    ENDED = "ended"
    """It has ended at home: its tokens are nobody's."""
    CONCLUDED = "concluded"
    """The other net has emitted that it is done, or has failed."""


@dataclass(frozen=True, slots=True)
class JobUpdateArrived:
    """Event: another net tells an update of a job with tokens here.

    Attributes:
        key: The job, at home.
        home: Whether that is here.
        update: The change.
        net: Net that tells it.
        error: Why it is cancelled, or has failed.
        results: What has been done for it.
    """

    key: JobKey
    home: bool
    update: JobUpdate
    net: str
    error: ImError | None = None
    results: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class NodeForgotten:
    """Event: a node is gone for good; tokens sent there are lost, and the jobs here end."""

    node: str
    nets: tuple[str, ...]
    error: ImError


@dataclass(frozen=True, slots=True)
class ActionEnded:
    """An action has confirmed, or failed with ``error``."""

    activity: Activity
    error: ImError | None
    results: dict[str, object]


@dataclass(frozen=True, slots=True)
class ObjectInvalidated:
    """Event: a data object, by the name in the DOM, has lost the validity."""

    name: str


@dataclass(frozen=True, slots=True)
class Answered:
    """Event: answer to the question about an action in doubt."""

    activity: Activity
    answer: Answer


@dataclass(frozen=True, slots=True)
class GuardsChanged:
    """Event: an input of guards may have changed: a declared source, or an unknown one (empty)."""

    source: str = ""


@dataclass(frozen=True, slots=True)
class ModeSet:
    """Event: an operator sets the mode; held and proposed transitions are decided again."""

    mode: Mode


@dataclass(frozen=True, slots=True)
class PauseSet:
    """An operator has nothing new started, or everything go on."""

    paused: bool


@dataclass(frozen=True, slots=True)
class BreakpointSet:
    """Event: an operator has a transition, as written, wait to be confirmed at each firing, or no more."""

    transition: str
    on: bool


@dataclass(frozen=True, slots=True)
class StepAsked:
    """An operator lets one transition fire (mode step)."""


@dataclass(frozen=True, slots=True)
class Confirmed:
    """An operator lets a proposed transition fire (mode supervised, or at a breakpoint)."""

    transition: str


Event = (
    CommandWritten
    | CommandCancelled
    | CommandHeld
    | RequestArrived
    | RequestCancelled
    | RequestHeld
    | TokenArrived
    | JobUpdateArrived
    | NodeForgotten
    | ActionEnded
    | ObjectInvalidated
    | Answered
    | GuardsChanged
    | ModeSet
    | PauseSet
    | BreakpointSet
    | StepAsked
    | Confirmed
)
