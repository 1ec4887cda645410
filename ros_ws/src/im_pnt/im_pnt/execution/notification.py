"""Notifications of a net: numbered firings for the observer, and tokens and replies for other nets."""

import enum
import threading
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

from im_core.errors import ImError
from im_pnt.execution.events import JobUpdate
from im_pnt.execution.jobs import Job, JobKey, Lineage, Request
from im_pnt.execution.operator import Mode
from im_pnt.model.net import RemotePlace, Transition


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


class Observer:
    """Observer of a net without any effect. Override the methods of interest.

    >>> class Printer(Observer):
    ...     def fired(self, firings):
    ...         print(*(f"{firing.transition} {firing.phase.name}" for firing in firings), sep=", ")
    >>> executor = Executor(net, functions, runner, Nowhere(), Printer())
    >>> job = executor.command(Command(1, "bake"))
    >>> executor.pump()
    bake START, bake END, empty END
    False
    """

    def fired(self, firings: Sequence[Firing]) -> None:
        """Called with the firings of one net since the last call, in order: once a turn, and before anything leaves."""

    def progressed(self, net: str, job: Job | None, text: str, fraction: float) -> None:
        """Take the progress of an action; from the thread of the action."""

    def emitted(self, net: str, symbol: str, lineage: Lineage) -> None:
        """Called for each symbol written to the output tape."""

    def troubled(self, net: str, text: str) -> None:
        """Take an event for the log: a refused token, a late completion, a failed guard."""

    def forgot(self, text: str) -> None:
        """Take a loss of memory, here or there: a journal is gone, old or torn."""
        self.troubled("", text)

    def unreached(self, node: str, text: str) -> None:
        """Take the warning about an unreachable node; an empty text once messages reach the node again."""
        if text:
            self.troubled("", text)

    def chose(self, choice: "StrategyChosen") -> None:
        """Called for each choice among strategies, before the firing."""

    def operated(
        self, net: str, mode: Mode, paused: bool, proposed: tuple[str, ...], breakpoints: tuple[str, ...]
    ) -> None:
        """Take a change of the mode, the pause, the proposed transitions or the breakpoints."""


class StrategyChosen(NamedTuple):
    """Choice among strategies.

    Attributes:
        net: Name of the net.
        places: Input places of the transition taken that others contend for.
        probabilities: Of each contending transition.
        entropy: Of the choice [nats].
        taken: The transition that fires.
        context: Of the strategy that is taken.
        job: For whom; None: for nobody.
    """

    net: str
    places: tuple[str, ...]
    probabilities: Mapping[str, float]
    entropy: float
    taken: str
    context: str
    job: Job | None


class Departure(NamedTuple):
    """Departure of a job's tokens to another net.

    Attributes:
        job: Whose they are.
        failure: The last failure of a visit.
        results: What that net has not been told.
        held: Whether nothing is begun for the job.
    """

    job: Job
    failure: ImError | None
    results: dict[str, object]
    held: bool


class Outlet(Protocol):
    """Where tokens for other nets and replies to callers go."""

    def send_token(self, net: str, target: RemotePlace, count: int, departure: Departure | None = None) -> None:
        """Send tokens to a place of another net; with the departure, where the tokens belong to a job."""

    def send_job_update(
        self, net: str, job: Job, update: JobUpdate, to: str, error: ImError | None, results: dict[str, object]
    ) -> None:
        """Tell another net an update of a job with tokens there."""

    def send_settled(
        self, net: str, key: JobKey, node: str, to: str, error: ImError | None, results: dict[str, object]
    ) -> None:
        """Tell the sender of a job's token: the work for the token is done."""

    def send_reply(self, request: Request, error: ImError | None, results: dict[str, object]) -> None:
        """Answers a request."""


class Nowhere:
    """Outlet of a restored or re-run net, without an effect: the messages were sent before."""

    def send_token(self, net: str, target: RemotePlace, count: int, departure: Departure | None = None) -> None:
        """Send nothing."""

    def send_job_update(
        self, net: str, job: Job, update: JobUpdate, to: str, error: ImError | None, results: dict[str, object]
    ) -> None:
        """Send nothing."""

    def send_settled(
        self, net: str, key: JobKey, node: str, to: str, error: ImError | None, results: dict[str, object]
    ) -> None:
        """Send nothing."""

    def send_reply(self, request: Request, error: ImError | None, results: dict[str, object]) -> None:
        """Send nothing."""


class Notifier:
    """Numbering of the firings of a net, and the report in batches."""

    def __init__(self, net: str, observer: Observer) -> None:
        self.sequence = 0
        self._net, self._observer = net, observer
        self._fired: list[Firing] = []
        self._thread: int | None = None

    @property
    def observer(self) -> Observer:
        """Observer of the net; a successor gets the firings from then on."""
        return self._observer

    @observer.setter
    def observer(self, observer: Observer) -> None:
        self.flush()
        self._observer = observer

    def rename(self, net: str) -> None:
        """Report further firings under another name of the net."""
        self.flush()
        self._net = net

    def begin(self) -> None:
        """Note the start of the net's loop in the current thread."""
        self._thread = threading.get_ident()

    def flush(self) -> None:
        """Report the firings since the last call."""
        if self._fired:
            firings, self._fired = self._fired, []
            self._observer.fired(firings)

    def note(
        self,
        transition: str,
        phase: Phase,
        lineage: Lineage,
        *,
        symbol: str = "",
        duration: float = 0.0,
        message: str = "",
    ) -> None:
        """Count a firing.

        Args:
            transition: Transition as written, or the one of a coordination structure.
            phase: What happened.
            lineage: What it was done for.
            symbol: Symbol read from the tape, or written to it.
            duration: Time since START [s].
            message: Why it failed, is cancelled or in doubt.
        """
        job = lineage.job
        command, progress = (job.command.id, job.progress) if job is not None else (0, -1.0)
        self.sequence += 1
        self._fired.append(
            Firing(self._net, transition, self.sequence, phase, symbol, command, message, duration, progress)
        )

    def progressed(self, lineage: Lineage, text: str, fraction: float) -> None:
        """Take a report of progress."""
        if lineage.job is not None and fraction >= 0.0:
            lineage.job.progress = fraction
        if threading.get_ident() == self._thread:
            self.flush()
        self.observer.progressed(self._net, lineage.job, text, fraction)

    def emitted(self, symbol: str, lineage: Lineage) -> None:
        """Report a symbol on the output tape."""
        self.flush()
        self.observer.emitted(self._net, symbol, lineage)

    def troubled(self, text: str) -> None:
        """Complains."""
        self.flush()
        self.observer.troubled(self._net, text)

    def chose(self, choice: StrategyChosen) -> None:
        """Report a choice among strategies."""
        self.flush()
        self.observer.chose(choice)

    def operated(self, mode: Mode, paused: bool, proposed: tuple[str, ...], breakpoints: tuple[str, ...]) -> None:
        """Report the present operation of the net."""
        self.flush()
        self.observer.operated(self._net, mode, paused, proposed, breakpoints)


def failure_of(job: Job | None, transition: Transition, failure: ImError | None = None) -> ImError:
    """Return the reason of a failed job: the present failure, the last one, the ``message``, or the place of end."""
    if failure is not None:
        return failure
    if job is not None and job.last_failure is not None:
        return job.last_failure
    if job is not None and (told := str(job.results.get("message", ""))):
        return ImError(told, code="net", transition=transition.name)
    return ImError(f"the net ended it at transition {transition.name}", code="net", transition=transition.name)
