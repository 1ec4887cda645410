"""Jobs of a net: commands of the tape and requests of other nets; and the running actions."""

import enum
import re
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from im_core.errors import FOREIGN, ImError, as_exception
from im_pnt.execution.timers import Timer
from im_pnt.expression.evaluation import as_text
from im_pnt.model.action import Action


@dataclass(frozen=True, slots=True)
class Command:
    """Command of the input tape, passed on with the requests.

    Attributes:
        id: Number of the command, 0 where there is none.
        symbol: Its symbol.
        arguments: What it was given.
        priority: Larger goes first, where commands wait for the same.
        scope: Begins the names of its data objects, ``<node>/<incarnation of the node>-<id>``: no other command has the
            same, also after a restart. Empty: :func:`scope_of` gives one.
    """

    id: int = 0
    symbol: str = ""
    arguments: dict[str, object] = field(default_factory=dict)
    priority: int = 0
    scope: str = ""


NO_COMMAND = Command()


def scope_of(net: str, command: Command) -> str:
    """Return the name prefix of a command's data objects; ``<net>/0`` without a command."""
    return command.scope or f"{net}/{command.id}"


_ARGUMENT = re.compile(r"\$\{arguments\.(\w+)\}")


def filled_name(name: str, arguments: Mapping[str, object]) -> str:
    """Return the name of a data object with the values of the arguments: ``path/${arguments.group}``."""

    def said(match: re.Match[str]) -> str:
        return as_text(arguments[match[1]]) if match[1] in arguments else match[0]

    return _ARGUMENT.sub(said, name) if "$" in name else name


def object_name(name: str, scope: str, shared: Iterable[str], arguments: Mapping[str, object]) -> str:
    """Return the name of a data object in the DOM.

    Args:
        name: What nets and requests call it, see :func:`filled_name`; with ``/`` before it, one of the machine:
            ``/calibration``.
        scope: Of the command that it belongs to, see :func:`scope_of`.
        shared: Names that the net has declared to be of the machine, as they are written there.
        arguments: What the request in work, or else the command, was given.
    """
    called = filled_name(name, arguments)
    if called.startswith("/"):
        return called[1:]
    of_machine = any(called == filled_name(declared, arguments) for declared in shared)
    return called if of_machine else f"{scope}/{called}"


@dataclass(frozen=True, slots=True)
class Request:
    """A request to a service of a net (paper, Figure 11).

    Attributes:
        id: Name of the request, unique over all processes and their restarts.
        net: Net that is asked.
        service: Its service.
        caller_node: Node of the caller; empty for a net of the same process.
        caller_net: Net that asks.
        caller_transition: Transition that waits for the reply.
        command: Command it is made for.
        arguments: What the service is given.
    """

    id: str
    net: str
    service: str
    caller_node: str
    caller_net: str
    caller_transition: str
    command: Command
    arguments: dict[str, object]


class JobKey(NamedTuple):
    """Identity of a job among all nets and processes.

    Attributes:
        process: Name of the incarnation of the process where it was begun, as the names of its requests begin.
        net: Its net.
        number: Its number there.
    """

    process: str
    net: str
    number: int


@dataclass(frozen=True, slots=True)
class Owner:
    """Owner of a token from another net.

    Attributes:
        key: The job, at home.
        symbol: Symbol that begins and ends it, empty for a request to a service.
        command: Its command.
        arguments: Its arguments.
    """

    key: JobKey
    symbol: str
    command: Command
    arguments: dict[str, object]


@dataclass(frozen=True, slots=True)
class TokenContext:
    """Context of a job's token on the way to another net.

    Attributes:
        owner: Whose it is.
        home: Whether it comes back to the net of its job.
        node: Node of the net that sends it; empty for one of the same process.
        net: That net.
        failure: The last failure of what was done for it where it comes from, if that is not its home.
        results: What has been done for the job and is not known there yet.
        cancelled: Why the job should come to an end early, None if it should not.
        held: Whether nothing is begun for it.
    """

    owner: Owner
    home: bool
    node: str
    net: str
    failure: ImError | None = None
    results: dict[str, object] = field(default_factory=dict)
    cancelled: ImError | None = None
    held: bool = False


@dataclass(frozen=True, slots=True)
class Visit:
    """Foreign job with tokens here.

    Attributes:
        owner: The job, at home.
        node: Node of the net that sent the first of them, and is told when none is left; empty in the same process.
        net: That net.
    """

    owner: Owner
    node: str
    net: str


@dataclass(frozen=True, slots=True)
class CommandResult:
    """How a command ended.

    Attributes:
        success: Whether the net emitted ``<symbol>_done``.
        error: Why not.
        results: What its actions left in ``ctx.result``.
    """

    success: bool
    error: ImError | None
    results: dict[str, object]


class JobData(NamedTuple):
    """Data of the actions of a job, as JSON data: memory, results, progress."""

    memory: dict[str, object]
    results: dict[str, object]
    progress: float


@dataclass(slots=True, eq=False)
class Job:
    """Command or request in work, or the part here of another net's job.

    Attributes:
        command: The command.
        arguments: Arguments of the command, or of the request.
        request: The request, for a job that another net asked for.
        visit: Whose tokens these are, for a job of another net.
        away: Tokens of it that were sent to other nets and whose work is not done, by net.
        told: Of a visit: the results that each net has been told that its tokens, or its end, were sent to.
        results: What is returned in the end; actions write it.
        replies: What actions done for this job were answered, by transition: results of requests, kept fields.
        memory: What its actions keep for each other; never sent to the caller.
        last_failure: The last failure of an action done for it.
        progress: Progress 0..1, negative where unknown.
        cancelled: Whether it should come to an end early.
        unwanted: Whether that was so before it was accepted, or while it was paused: nothing ran that could be called
            off, so the next action fails and is not begun, unless one fails before.
        closed: Whether it has ended.
        number: Counts the jobs of its net from 1; 0 before the net has taken it.
        from_tape: Whether it came over the input tape: a command, or a request of another net that is one.
        waiting: Whether it is still on the tape.
        recorded: Its data as they were written to the journal last, None: never.
        on_closed: Called once with the result.
        stalled: Transitions whose guards did not let it pass when they were asked last.
    """

    command: Command
    arguments: dict[str, object]
    request: Request | None = None
    results: dict[str, object] = field(default_factory=dict)
    replies: dict[str, dict[str, object]] = field(default_factory=dict)
    memory: dict[str, object] = field(default_factory=dict)
    last_failure: ImError | None = None
    progress: float = -1.0
    cancelled: bool = False
    unwanted: bool = False
    closed: bool = False
    number: int = 0
    from_tape: bool = False
    waiting: bool = False
    recorded: JobData | None = None
    on_closed: Callable[[CommandResult], None] | None = None
    visit: Visit | None = None
    away: dict[str, int] = field(default_factory=dict)
    told: dict[str, dict[str, object]] = field(default_factory=dict)
    stalled: set[int] = field(default_factory=set)

    @property
    def symbol(self) -> str:
        """Symbol of the command, or service of the request."""
        return self.command.symbol if self.request is None else self.request.service

    @property
    def is_command(self) -> bool:
        """Whether the job is a command of the net's own tape."""
        return self.request is None and self.visit is None

    def close(self, error: ImError | None) -> None:
        """End the job, once."""
        if self.closed:
            return
        self.closed = True
        if self.on_closed is not None:
            self.on_closed(CommandResult(error is None, error, self.results))


class Lineage(NamedTuple):
    """Lineage of a token, unseen by the net: the job (None: none), and the failure behind the token."""

    job: Job | None
    failure: ImError | None

    def failing(self, failure: ImError | None) -> "Lineage":
        """Return the lineage of the same job with another failure."""
        return self if failure is self.failure else Lineage(self.job, failure)


NO_LINEAGE = Lineage(None, None)


class ActivityState(enum.StrEnum):
    """State of an action: the marked one of the places."""

    ACTIVE = "active"
    CANCELLING = "cancelling"
    IN_DOUBT = "in_doubt"


class Reply(NamedTuple):
    """How an action has ended.

    Attributes:
        error: Why it failed, None if it has not.
        results: Results of a request, or what is kept of another answer.
    """

    error: ImError | None
    results: dict[str, object]


@dataclass(slots=True, eq=False)
class Activity:
    """Running action: a token on ``t.active``, ``t.cancelling`` or ``t.in_doubt``.

    Attributes:
        number: Sequence number of its START, by which a journal knows it.
        net: Net it belongs to.
        transition: Transition as written.
        action: What is done.
        lineage: What the tokens taken carried.
        began: When it began (monotonic) [s].
        deadline: When it comes in doubt (monotonic) [s], None: never.
        place: Number of the place that its token is on.
        objects: Data objects that must be valid when it has succeeded.
        state: How far it is.
        cancelled: Whether it was asked to end early.
        concluded: Whether what its transition returns and stores has been.
        checked: Whether the data objects have been looked at.
        reply: How it has ended, when that is known and the net has not yet fired.
        doubt: Why it is in doubt, or why a transition has asked it to end early; None if neither.
        doubted: When it came in doubt (monotonic) [s].
        timer: What strikes next: its deadline, or the next question about it.
        on_cancel: Called when it is asked to end early.
        on_release: Called when its job is not held any more.
        on_abandon: Called with the error when its job is abandoned.
        told: What its transition says of it, with values; None: not known yet, or nothing is said.
        begun_as: Incarnation and net, as goals were named when it began, if they are named otherwise since; or empty.
    """

    number: int
    net: str
    transition: str
    action: Action
    lineage: Lineage
    began: float
    place: int
    deadline: float | None = None
    objects: tuple[str, ...] = ()
    state: ActivityState = ActivityState.ACTIVE
    cancelled: bool = False
    concluded: bool = False
    checked: bool = False
    reply: Reply | None = None
    doubt: ImError | None = None
    doubted: float = 0.0
    timer: Timer | None = None
    told: str | None = None
    on_cancel: list[Callable[[], None]] = field(default_factory=list)
    on_release: list[Callable[[], None]] = field(default_factory=list)
    on_abandon: list[Callable[[ImError], None]] = field(default_factory=list)
    begun_as: str = ""

    def when_cancelled(self, callback: Callable[[], None]) -> None:
        """Call a function at the request to end early; at once if the action has got one."""
        if self.cancelled:
            callback()
        else:
            self.on_cancel.append(callback)

    def cancel(self) -> list[Exception]:
        """Ask the action to end early, once; the end still decides on the outputs.

        Returns:
            What its callbacks raised.
        """
        if self.cancelled:
            return []
        self.cancelled = True
        raised: list[Exception] = []
        for callback in self.on_cancel:
            try:
                callback()
            except FOREIGN as error:  # foreign code must not keep the others from being told
                raised.append(as_exception(error))
        return raised


def as_failure(activity: Activity, error: BaseException) -> ImError:
    """Return an exception of an action as the failure on the net's tokens."""
    if isinstance(error, ImError):
        return error
    return ImError(
        f"{activity.action} of transition {activity.transition} broke: {type(error).__name__}: {error}",
        code="action",
        net=activity.net,
        transition=activity.transition,
    )


class Ledger:
    """Open jobs in the order of the arrival.

    Attributes:
        tape: The input tape.
        serving: Requests that hold the input semaphore SI, by their numbers, the oldest first.
        visits: Jobs of other nets whose tokens are here.
        count: Jobs entered so far; the number of the last one.
    """

    def __init__(self) -> None:
        self.tape = InputTape()
        self.serving: dict[int, Job] = {}
        self.visits: dict[JobKey, Job] = {}
        self.count = 0
        self._open: dict[int, Job] = {}

    def add(self, job: Job) -> None:
        """Enter and number a job."""
        self.count += 1
        job.number = self.count
        self.reopen(job)

    def reopen(self, job: Job) -> None:
        """Enter a job under the existing number."""
        self._open[job.number] = job
        if job.visit is not None:
            self.visits[job.visit.owner.key] = job

    def close(self, job: Job, error: ImError | None) -> None:
        """End a job and inform the client."""
        self._open.pop(job.number, None)
        self.serving.pop(job.number, None)
        if job.visit is not None:
            self.visits.pop(job.visit.owner.key, None)
        job.close(error)

    def __len__(self) -> int:
        return len(self._open)

    def is_open(self, job: Job) -> bool:
        """Whether a job has not ended."""
        return job.number in self._open

    def jobs(self) -> list[Job]:
        """Return the open jobs in the order of the arrival."""
        return list(self._open.values())

    def job(self, number: int) -> Job | None:
        """Return an open job by the number."""
        return self._open.get(number)

    def of_key(self, key: JobKey, home: bool) -> Job | None:
        """Return an open job of the net (``home``), or a foreign one."""
        return self.job(key.number) if home else self.visits.get(key)

    def of_command(self, command_id: int | None) -> list[Job]:
        """Return the open jobs of a command of the net's own tape, or all jobs."""
        jobs = self._open.values()
        return [job for job in jobs if command_id is None or (job.is_command and job.command.id == command_id)]

    def of_request(self, request_id: str) -> list[Job]:
        """Return the open jobs of a request: one or none."""
        return [job for job in self._open.values() if job.request is not None and job.request.id == request_id]

    def begun_commands(self) -> list[Job]:
        """Return the open jobs read from the tape."""
        return [job for job in self._open.values() if job.from_tape and not job.waiting]

    def ended_by(self, emitted: str, own: Job | None) -> Job | None:
        """Return the job ended by an output symbol: the job of the firing, or the oldest job of the symbol."""
        if own is not None and own.from_tape and ends(emitted, own.symbol) is not None:
            return own if self.is_open(own) else None
        return next((job for job in self.begun_commands() if ends(emitted, job.symbol) is not None), None)


DONE_SUFFIX = "_done"
FAILED_SUFFIX = "_failed"


class InputTape:
    """Unread symbols with the jobs; a transition reads the oldest of the symbol."""

    def __init__(self) -> None:
        self._waiting: dict[str, deque[Job]] = {}

    def write(self, job: Job) -> None:
        """Put a job at the end."""
        job.from_tape = job.waiting = True
        self._waiting.setdefault(job.symbol, deque()).append(job)

    def has(self, symbol: str) -> bool:
        """Whether a symbol is on the tape."""
        return bool(self._waiting.get(symbol))

    def of_symbol(self, symbol: str) -> Collection[Job]:
        """Return the jobs of a symbol, the oldest first."""
        return self._waiting.get(symbol, ())

    def withdraw(self, job: Job) -> bool:
        """Take a job from the tape, from any position; return whether the job was on the tape."""
        if not job.waiting:
            return False
        self._waiting[job.symbol].remove(job)
        job.waiting = False
        return True

    def waiting(self) -> list[Job]:
        """Return the jobs on the tape, symbol by symbol."""
        return [job for jobs in self._waiting.values() for job in jobs]


def ends(emitted: str, symbol: str) -> bool | None:
    """Return whether an output symbol means a done command (True), a failed one (False), or neither (None)."""
    if emitted == symbol + DONE_SUFFIX:
        return True
    return False if emitted == symbol + FAILED_SUFFIX else None
