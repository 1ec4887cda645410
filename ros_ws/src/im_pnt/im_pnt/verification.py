"""Seam to the verifier: no net runs unverified, and execution does not know the method of the proof.

:mod:`im_pnt_analysis.verify` is the verifier of this workspace; whatever answers to these protocols may take its
place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from im_core.processes.startup import unproved_allowed
from im_pnt.model.net import Net

KINDS = ("growth", "overflow", "deadlock", "lost_command", "held_resource", "assumption", "unheld")
"""Kinds of refusals."""


@dataclass(frozen=True, slots=True)
class Counterexample:
    """Fault, and the shortest way to the fault.

    Attributes:
        kind: One of :data:`KINDS`.
        reason: One sentence.
        sequence: Transitions to fire from the initial marking, by their names in the composition.
        marking: Marked places where it goes wrong.
        repeat: Transitions that can be repeated for ever after the sequence (unbounded nets).
    """

    kind: str
    reason: str
    sequence: tuple[str, ...]
    marking: dict[str, int]
    repeat: tuple[str, ...] = ()


class Verification(Protocol):
    """Whether nets may run together."""

    @property
    def states(self) -> int | None:
        """Number of reachable markings; None if not counted."""

    @property
    def time_s(self) -> float:
        """How long the verification took [s]."""

    @property
    def sentence(self) -> str:
        """The verdict in one sentence: verified, and how; refused, and why; or not proved, and why not."""

    @property
    def unproved(self) -> str:
        """Reason of a missing decision in time; empty for a decided one."""

    @property
    def composed(self) -> Sequence[Net]:
        """Composed nets of the refusal, with the transitions of the sequence."""

    @property
    def refusals(self) -> Sequence[Counterexample]:
        """Reasons against running the nets."""

    def require_ok(self) -> None:
        """Accept or refuse.

        Raises:
            VerificationError: The nets must not run, and it carries the shortest firing sequence that shows why; or it
                is not proved that they may.
        """


def accept(report: Verification) -> None:
    """Accept or refuse; accept unproved nets where the machine was started so.

    Raises:
        VerificationError: As of :meth:`Verification.require_ok`.
    """
    if not (report.unproved and unproved_allowed()):
        report.require_ok()


Verifier = Callable[[Sequence[Net]], Verification]
"""Verifies nets, alone or composed; raises NetError where they do not fit together."""
