"""Whom a net tells what: its observer of each firing, numbered, and other nets of tokens and replies."""

from collections.abc import Mapping
from typing import Protocol

from im_core.errors import ImError
from im_pnt.events import Firing, Observer, Phase
from im_pnt.jobs import Job, Lineage, Request
from im_pnt.modes import Mode
from im_pnt.net import RemotePlace, Transition


class Outlet(Protocol):
    """Where tokens for other nets and replies to callers go."""

    def send_token(self, net: str, target: RemotePlace, count: int) -> None:
        """Sends tokens to a place of another net."""

    def send_reply(self, request: Request, error: ImError | None, results: dict[str, object]) -> None:
        """Answers a request."""


class Teller:
    """Numbers the firings of a net, and tells of them.

    Args:
        net: Name of the net.
        observer: Whom.

    Attributes:
        observer: Whom it tells.
        sequence: Number of the last firing.
    """

    def __init__(self, net: str, observer: Observer) -> None:
        self.observer = observer
        self.sequence = 0
        self._net = net

    def fired(
        self,
        transition: str,
        phase: Phase,
        lineage: Lineage,
        *,
        symbol: str = "",
        duration: float = 0.0,
        message: str = "",
    ) -> None:
        """Counts a firing and tells of it.

        Args:
            transition: Transition as written, or the one of a coordination structure.
            phase: What happened.
            lineage: What it was done for.
            symbol: Symbol read from the tape, or written to it.
            duration: Time since START [s].
            message: Why it failed, is cancelled or in doubt.
        """
        self.sequence += 1
        job = lineage.job
        self.observer.fired(
            Firing(
                self._net,
                transition,
                self.sequence,
                phase,
                symbol,
                job.command.id if job is not None else 0,
                message,
                duration,
                job.progress if job is not None else -1.0,
            )
        )

    def progressed(self, lineage: Lineage, text: str, fraction: float) -> None:
        """Takes a report of progress."""
        if lineage.job is not None and fraction >= 0.0:
            lineage.job.progress = fraction
        self.observer.progressed(self._net, lineage.job, text, fraction)

    def emitted(self, symbol: str, lineage: Lineage) -> None:
        """Tells of a symbol on the output tape."""
        self.observer.emitted(self._net, symbol, lineage)

    def troubled(self, text: str) -> None:
        """Complains."""
        self.observer.troubled(self._net, text)

    def chose(self, places: tuple[str, ...], probabilities: Mapping[str, float], entropy: float, taken: str) -> None:
        """Tells of a choice among strategies; the entropy is in nats."""
        self.observer.chose(self._net, places, probabilities, entropy, taken)

    def operated(self, mode: Mode, paused: bool, proposed: tuple[str, ...]) -> None:
        """Tells how the net is operated now."""
        self.observer.operated(self._net, mode, paused, proposed)


def failure_of(job: Job | None, transition: Transition, failure: ImError | None = None) -> ImError:
    """Why a job failed: the failure at hand, the last one of the job, or only where it ended."""
    if failure is not None:
        return failure
    if job is not None and job.last_failure is not None:
        return job.last_failure
    return ImError(f"the net ended it at transition {transition.name}", code="net", transition=transition.name)
