"""Synchronised start-up (paper, section 3): no task enters a phase before all tasks have finished the one before."""

from collections.abc import Iterable, Sequence
from enum import IntEnum

from im_bringup.registry import Progress, TaskRecord


class Phase(IntEnum):
    """What the bootstrap asks of all tasks, as on ``/im/phase``."""

    LOAD = 0
    CONFIGURE = 1
    START = 2
    SHUTDOWN = 3


#: How far a task must be for its part of a phase to be done.
_DONE = {Phase.LOAD: Progress.LOADED, Phase.CONFIGURE: Progress.CONFIGURED, Phase.START: Progress.READY}
_WORDS = {Phase.LOAD: "loaded", Phase.CONFIGURE: "configured", Phase.START: "ready"}


def done(phase: Phase, records: Iterable[TaskRecord]) -> bool:
    """Whether all tasks have finished a phase."""
    return all(_finished(phase, record) for record in records)


def next_phase(phase: Phase, records: Sequence[TaskRecord]) -> Phase:
    """The phase the machine may be in: the following one if all tasks have finished this one."""
    if phase < Phase.START and done(phase, records):
        return Phase(phase + 1)
    return phase


def missing(phase: Phase, records: Iterable[TaskRecord]) -> list[str]:
    """One sentence for each task that has not finished a phase: who, where it is, and why if it told."""
    sentences = []
    for record in records:
        if _finished(phase, record):
            continue
        if record.progress is Progress.FAILED:
            sentences.append(f"{record.name} failed: {record.detail}")
        elif record.progress is Progress.DEAD:
            sentences.append(f"{record.name} died: {record.detail}")
        else:
            sentences.append(f"{record.name} is {record.progress.word}, not {_WORDS[phase]}")
    return sentences


def broken(records: Iterable[TaskRecord]) -> list[TaskRecord]:
    """The tasks that will not go on by themselves: failed or dead."""
    return [record for record in records if record.progress in (Progress.FAILED, Progress.DEAD)]


def _finished(phase: Phase, record: TaskRecord) -> bool:
    if phase is Phase.SHUTDOWN:
        return record.progress is Progress.DEAD
    return _DONE[phase] <= record.progress <= Progress.READY
