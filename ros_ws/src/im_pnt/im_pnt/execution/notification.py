"""What a net tells: its observer each firing, numbered, and other nets of tokens and replies."""

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
    """Is told what a net does; does nothing with it. Override what is of interest."""

    def fired(self, firings: Sequence[Firing]) -> None:
        """Called with the firings of one net since the last call, in order: once a turn, and before anything leaves."""

    def progressed(self, net: str, job: Job | None, text: str, fraction: float) -> None:
        """Called when an action reports progress; from whatever thread it does."""

    def emitted(self, net: str, symbol: str, lineage: Lineage) -> None:
        """Called for each symbol written to the output tape."""

    def troubled(self, net: str, text: str) -> None:
        """Called for what should be in a log: refused tokens, late completions, guards that fail."""

    def forgot(self, text: str) -> None:
        """Called where something that happened is not remembered, here or there: a journal is gone, old or torn."""
        self.troubled("", text)

    def unreached(self, node: str, text: str) -> None:
        """Take the sentence that no message reaches another node; an empty one where messages reach the node again."""
        if text:
            self.troubled("", text)

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


class Departure(NamedTuple):
    """What tokens of a job take along to another net.

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
        """Sends tokens to a place of another net; with what they take along, where they are of a job."""

    def send_job_update(
        self, net: str, job: Job, update: JobUpdate, to: str, error: ImError | None, results: dict[str, object]
    ) -> None:
        """Tells another net of a job whose tokens have crossed."""

    def send_settled(
        self, net: str, key: JobKey, node: str, to: str, error: ImError | None, results: dict[str, object]
    ) -> None:
        """Tells the net that has sent a token of a job that the work of that is done."""

    def send_reply(self, request: Request, error: ImError | None, results: dict[str, object]) -> None:
        """Answers a request."""


class Nowhere:
    """Takes what a net sends that is brought back or run again, and sends nothing: it has been sent."""

    def send_token(self, net: str, target: RemotePlace, count: int, departure: Departure | None = None) -> None:
        """Sends nothing."""

    def send_job_update(
        self, net: str, job: Job, update: JobUpdate, to: str, error: ImError | None, results: dict[str, object]
    ) -> None:
        """Sends nothing."""

    def send_settled(
        self, net: str, key: JobKey, node: str, to: str, error: ImError | None, results: dict[str, object]
    ) -> None:
        """Sends nothing."""

    def send_reply(self, request: Request, error: ImError | None, results: dict[str, object]) -> None:
        """Sends nothing."""


class Notifier:
    """Numbers the firings of a net, and tells of them in batches.

    Args:
        net: Name of the net.
        observer: Whom.

    Attributes:
        sequence: Number of the last firing.
    """

    def __init__(self, net: str, observer: Observer) -> None:
        self.sequence = 0
        self._net, self._observer = net, observer
        self._fired: list[Firing] = []
        self._thread: int | None = None

    @property
    def observer(self) -> Observer:
        """Whom it tells; who takes the place of another is told of what fires from then on."""
        return self._observer

    @observer.setter
    def observer(self, observer: Observer) -> None:
        self.flush()
        self._observer = observer

    def begin(self) -> None:
        """Notes that the loop of the net runs in this thread now."""
        self._thread = threading.get_ident()

    def flush(self) -> None:
        """Tells of what has fired since the last time."""
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
        """Counts a firing.

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
        """Takes a report of progress."""
        if lineage.job is not None and fraction >= 0.0:
            lineage.job.progress = fraction
        if threading.get_ident() == self._thread:
            self.flush()
        self.observer.progressed(self._net, lineage.job, text, fraction)

    def emitted(self, symbol: str, lineage: Lineage) -> None:
        """Tells of a symbol on the output tape."""
        self.flush()
        self.observer.emitted(self._net, symbol, lineage)

    def troubled(self, text: str) -> None:
        """Complains."""
        self.flush()
        self.observer.troubled(self._net, text)

    def chose(self, places: tuple[str, ...], probabilities: Mapping[str, float], entropy: float, taken: str) -> None:
        """Tells of a choice among strategies; the entropy is in nats."""
        self.flush()
        self.observer.chose(self._net, places, probabilities, entropy, taken)

    def operated(self, mode: Mode, paused: bool, proposed: tuple[str, ...]) -> None:
        """Tells how the net is operated now."""
        self.flush()
        self.observer.operated(self._net, mode, paused, proposed)


def failure_of(job: Job | None, transition: Transition, failure: ImError | None = None) -> ImError:
    """Why a job failed: the failure at hand, the last one of the job, its ``message``, or only where it ended."""
    if failure is not None:
        return failure
    if job is not None and job.last_failure is not None:
        return job.last_failure
    if job is not None and (told := str(job.results.get("message", ""))):
        return ImError(told, code="net", transition=transition.name)
    return ImError(f"the net ended it at transition {transition.name}", code="net", transition=transition.name)
