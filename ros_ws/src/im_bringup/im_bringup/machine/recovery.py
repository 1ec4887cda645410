"""Decisions of ``recover``: the step to bring the machine nearer to ready."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from im_bringup.tasks.registry import Progress


class Step(Enum):
    """Next step of a recovery."""

    WAIT = "wait"
    """Something is on its way up."""
    CONFIGURE = "configure"
    """MCS is to start its servo process."""
    RESET = "reset"
    """MCS is to leave the emergency stop."""
    RESTART = "shutdown"
    """The task ``mcs`` is to be started again: nothing less has helped."""
    DONE = "done"
    """The machine is ready."""


@dataclass(frozen=True)
class McsCondition:
    """Reported condition of MCS.

    Attributes:
        state: State, as on ``/mcs/state``.
        reason: Why it is there, or empty.
        stale: Whether it has fallen silent.
        faulty: Whether its servo does not answer, or the testbed does not answer the servo (``/diagnostics``).
    """

    state: str
    reason: str
    stale: bool
    faulty: bool


def next_step(tasks: Mapping[str, str], mcs: McsCondition | None, patient: bool) -> Step:
    """The next step.

    Args:
        tasks: How far each task is, by name (:attr:`im_bringup.tasks.registry.Progress.word`).
        mcs: MCS; None if it has not been heard, or is not of this machine.
        patient: Whether what does not answer may still do so by itself.
    """
    if not tasks or any(word != Progress.READY.word for word in tasks.values()):
        return Step.WAIT
    if "mcs" not in tasks:
        return Step.DONE
    if mcs is None or mcs.stale:
        return Step.WAIT
    ways = {"unconfigured": Step.CONFIGURE, "estopped": Step.RESET}
    if mcs.state not in ways and not mcs.faulty:
        return Step.DONE
    if not patient:
        return Step.RESTART
    return ways.get(mcs.state, Step.WAIT)
