"""Entries of a net in the journal.

The ``record`` of an executor (None: no journal) is called with one entry *before* what it tells is done: before tokens
move, before an action begins, before tokens and replies leave, before a client is answered. Where it raises, nothing
was done. An entry is an event of the inbox when it is taken, a firing of the expanded net, or what a net decides beside
firing. Applying the entries in their order (:meth:`.firing.FiringRule.apply`) gives the same marking, lineages, tape,
jobs, activities and numbers; how they are written down is the business of :mod:`im_pnt_node.distributed.codec`.

1. A state is restored where there is one, and each entry since is replayed, before anything is posted. That starts
   nothing, asks no guard, sends nothing and tells no observer.
2. ``activity(number)`` finds the activity that a request of the exchange's own records belongs to.
3. ``resume()``: requests that the exchange has in its book go on waiting (``Runner.waits``), those that it has not
   are started again, for they had not left; an activity that had ended ends; every other comes in doubt and is asked
   about.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

from im_core.errors import ImError
from im_pnt.errors import NetError
from im_pnt.execution.events import (
    BreakpointSet,
    CommandCancelled,
    CommandHeld,
    CommandWritten,
    JobUpdateArrived,
    ModeSet,
    NodeForgotten,
    PauseSet,
    RequestArrived,
    RequestCancelled,
    RequestHeld,
    TokenArrived,
)
from im_pnt.execution.jobs import Job, JobData


class JobChange(NamedTuple):
    """How the data of a job have changed: differences of memory and results (None: none), and the progress."""

    memory: list[object] | None
    results: list[object] | None
    progress: float


class ActivityEnded(NamedTuple):
    """An action has ended (not: a plain function).

    What it has left in its job is told with that: before its transition fires something may be stored, and who comes
    back in between finishes what the action has begun.

    Attributes:
        number: Number of the activity.
        error: Why it failed, None if it has not.
        results: Results of a request, or what is kept of another answer.
        data: What its job holds now, or how that has changed; None: it has not, or nobody has looked yet.
    """

    number: int
    error: ImError | None
    results: dict[str, object]
    data: JobData | JobChange | None = None


class TransitionFired(NamedTuple):
    """Firing of a transition only moving tokens, one of a coordination structure, or ``t.start`` of an activity.

    Attributes:
        transition: Its name.
        job: Number of the job whose tokens it takes, 0: those of nobody; None: of whom it takes them first.
    """

    transition: str
    job: int | None = None


class PhaseFired(NamedTuple):
    """``t.cancel``, ``t.lost`` or ``t.lost.cancelling`` of an activity; ``error`` says why."""

    number: int
    transition: str
    error: ImError


class EndFired(NamedTuple):
    """``t.end*``, ``t.failed*`` or ``t.given_up`` of an activity.

    Attributes:
        number: Number of the activity.
        transition: The one that fires.
        error: Why the action failed, None if it has not.
        data: What its job holds now, or how that has changed; None: it has not.
    """

    number: int
    transition: str
    error: ImError | None
    data: JobData | JobChange | None


class MessageBuilt(NamedTuple):
    """Entry: the builder of a request, goal or message has changed the job; the message leaves afterwards.

    Attributes:
        number: Number of the activity.
        data: What its job holds now, or how that has changed.
    """

    number: int
    data: JobData | JobChange


class GuardBroke(NamedTuple):
    """Entry: a guard broke on a job, known by the number."""

    job: int
    error: ImError


class JobForgotten(NamedTuple):
    """Entry: the net came to rest and left a command open, known by the number of the job."""

    job: int
    error: ImError


class VisitSettled(NamedTuple):
    """Entry: nothing is left here of a foreign job, known by the number here."""

    job: int


NetEntry = (
    TransitionFired
    | PhaseFired
    | EndFired
    | MessageBuilt
    | CommandWritten
    | CommandCancelled
    | CommandHeld
    | RequestArrived
    | RequestCancelled
    | RequestHeld
    | TokenArrived
    | JobUpdateArrived
    | NodeForgotten
    | VisitSettled
    | ActivityEnded
    | ModeSet
    | PauseSet
    | BreakpointSet
    | GuardBroke
    | JobForgotten
)
Record = Callable[[NetEntry], None]


# JSON data.

_ATOMS, _LISTS = (bool, int, str), (list, tuple)  # as tuples: every command's token has arguments to be checked


def plain(value: object, where: str) -> object:
    """Return a copy of a value as JSON data; a tuple becomes a list.

    Raises:
        NetError: It has a part that JSON cannot carry; names the part.
    """
    try:
        return _plain(value, where)
    except RecursionError:
        raise NetError(f"{where} is nested too deeply, or contains itself; a journal cannot keep it") from None


def _plain(value: object, where: str) -> object:
    if value is None or isinstance(value, _ATOMS):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return float(value)
    if isinstance(value, _LISTS):
        return [_plain(item, f"{where}[{number}]") for number, item in enumerate(value)]
    if isinstance(value, dict):
        for key in value:
            if not isinstance(key, str):
                raise NetError(f"{where} has the key {key!r}; a journal keeps dictionaries whose keys are strings")
        return {key: _plain(item, f"{where}.{key}") for key, item in value.items()}
    raise NetError(
        f"{where} is {value!r:.80} ({type(value).__name__}); a journal keeps None, bool, int, finite float, str, "
        "list and dict",
        where=where,
    )


def plain_dict(value: object, where: str) -> dict[str, object]:
    """Return a copy of a dictionary as JSON data.

    Raises:
        NetError: It is no dictionary, or has a part that JSON cannot carry.
    """
    copy = plain(value, where)
    if not isinstance(copy, dict):
        raise NetError(f"{where} is {value!r:.80}, not a dictionary")
    return copy


# The data of a job. What has not changed since it was written is not written again.


def data_of(job: Job) -> JobData:
    """Return memory, results and progress of a job as JSON data.

    Raises:
        NetError: They have a part that JSON cannot carry.
    """
    memory = plain_dict(job.memory, "ctx.memory") if job.memory else {}
    results = plain_dict(job.results, "ctx.result") if job.results else {}
    return JobData(memory, results, float(job.progress))


def recorded_data(job: Job) -> JobData:
    """Return the last recorded data of a job."""
    return job.recorded or JobData({}, {}, -1.0)


def changed_data(job: Job) -> JobData | JobChange | None:
    """Return the data of a job at the first record, then the changes, None without any.

    Raises:
        NetError: They have a part that JSON cannot carry; the job has what was written last.
    """
    try:
        data, before = data_of(job), job.recorded
    except NetError:
        _restore_data(job)
        raise
    if before is None:
        job.recorded = data
        return data
    memory = difference(before.memory, data.memory) if before.memory or data.memory else None
    results = difference(before.results, data.results) if before.results or data.results else None
    if memory is None and results is None and data.progress == before.progress:
        return None
    job.recorded = data
    return JobChange(memory, results, data.progress) if before.memory or before.results else data


def add_results(job: Job, results: dict[str, object], recorded: bool) -> None:
    """Add the results from another net to the results of a job.

    Args:
        job: The job.
        results: Results by name, JSON data.
        recorded: Whether a journal knows of them.
    """
    job.results.update(results)
    if recorded and results:
        memory, kept, progress = recorded_data(job)
        job.recorded = JobData(memory, {**kept, **results}, progress)


def take_data(job: Job, data: JobData | JobChange) -> None:
    """Give a job the data, or the changes of the data.

    Raises:
        NetError: The changes are none.
    """
    if isinstance(data, JobChange):
        memory, results, progress = data
        kept = recorded_data(job)
        job.recorded = JobData(_renewed_dict(kept.memory, memory), _renewed_dict(kept.results, results), progress)
    else:
        job.recorded = data
    _restore_data(job)


def _restore_data(job: Job) -> None:
    """Give a job the last recorded data."""
    memory, results, job.progress = recorded_data(job)
    for mine, kept in ((job.memory, memory), (job.results, results)):
        mine.clear()
        mine.update(plain_dict(kept, "what was written"))


def difference(old: object, new: object) -> list[object] | None:
    """Return the difference of JSON data.

    Returns:
        ``["set", value]``; ``["keys", {key: difference}, [keys that are gone]]`` of a dictionary; ``["items", {index:
        difference}, [items that were appended]]`` of a list; None where they are equal.
    """
    if isinstance(old, dict) and isinstance(new, dict):
        keys: dict[str, object] = {}
        for key, value in new.items():
            change = difference(old[key], value) if key in old else ["set", value]
            if change is not None:
                keys[key] = change
        gone = [key for key in old if key not in new]
        return ["keys", keys, gone] if keys or gone else None
    if isinstance(old, list) and isinstance(new, list) and len(old) <= len(new):
        items: dict[str, object] = {}
        for index, (before, after) in enumerate(zip(old, new, strict=False)):
            change = difference(before, after)
            if change is not None:
                items[str(index)] = change
        return ["items", items, new[len(old) :]] if items or len(old) < len(new) else None
    return None if type(old) is type(new) and old == new else ["set", new]


def renewed(old: object, change: object) -> object:
    """Return JSON data with a difference applied; the old data are not used any more.

    Raises:
        NetError: The difference does not fit.
    """
    match change:
        case ["set", value]:
            return value
        case ["keys", dict(keys), list(gone)] if isinstance(old, dict):
            for key in gone:
                old.pop(key, None)
            for key, part in keys.items():
                old[key] = renewed(old.get(key), part)
            return old
        case ["items", dict(items), list(added)] if isinstance(old, list):
            for index, part in items.items():
                if not (index.isdecimal() and int(index) < len(old)):
                    raise NetError(f"there is no item {index} that could have changed")
                old[int(index)] = renewed(old[int(index)], part)
            old.extend(added)
            return old
    raise NetError(f"{str(change)[:200]} is no change of {str(old)[:200]}")


def _renewed_dict(old: dict[str, object], change: list[object] | None) -> dict[str, object]:
    new = old if change is None else renewed(old, change)
    if not isinstance(new, dict):
        raise NetError(f"{str(change)[:200]} makes no dictionary")
    return new
