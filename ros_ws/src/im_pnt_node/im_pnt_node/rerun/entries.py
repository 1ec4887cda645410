"""Recorded entries of a net, beside the present ones."""

import json

from im_core.errors import DataError, ImError
from im_pnt.errors import decode_error, encode_error
from im_pnt.execution.events import BreakpointSet, CommandCancelled, CommandWritten, ModeSet, PauseSet
from im_pnt.execution.jobs import JobData, Reply
from im_pnt.execution.journal_entries import (
    ActivityEnded,
    EndFired,
    JobChange,
    MessageBuilt,
    NetEntry,
    PhaseFired,
    TransitionFired,
)
from im_pnt_node.distributed.codec import NET_ENTRY, encode_json
from im_pnt_node.distributed.entries import Delivery
from im_pnt_node.rerun.difference import first_difference
from im_pnt_node.rerun.stream import Turn

#: Entries that arrive from outside; the others are what the net makes of them.
Input = Delivery | CommandWritten | CommandCancelled | ModeSet | PauseSet | BreakpointSet
#: Codes of errors whose sentences say how long something took.
BY_TIME = frozenset(("timeout", "in_doubt"))


class Entries:
    """Recorded entries of a net, and the number of repeated ones.

    Attributes:
        recorded: The entries, each with the turn of the loop in which it was told.
        reached: How many of them have happened again.
        seen: How many of them have been looked at.
    """

    def __init__(self) -> None:
        self.recorded: list[tuple[NetEntry, Turn]] = []
        self.reached = self.seen = 0
        self._early: set[int] = set()

    def advance(self, now: NetEntry) -> bool:
        """Note a repeated entry; return whether the entry was an expected one.

        What makes a message may be done a little earlier than it was: the loop had something else to do first.
        """
        rank = self.reached
        if isinstance(now, MessageBuilt):
            later = range(self.reached, len(self.recorded))
            rank = next((each for each in later if _same(self.recorded[each][0], now)), rank)
        if rank >= len(self.recorded) or not _same(self.recorded[rank][0], now):
            return False
        self._early.add(rank)
        while self.reached in self._early:
            self._early.remove(self.reached)
            self.reached += 1
        return True

    def next(self) -> NetEntry | None:
        """Return the next expected entry; None: there is none."""
        return self.recorded[self.reached][0] if self.reached < len(self.recorded) else None


def error_of(content: object) -> ImError | None:
    """Return a recorded error.

    Raises:
        DataError: It is none.
    """
    try:
        return decode_error(content)
    except ValueError as error:
        raise DataError(str(error)) from error


def _same(recorded: NetEntry, now: NetEntry) -> bool:
    """Return whether entries are equal, up to the duration in the sentence of a time-out."""
    return type(recorded) is type(now) and _timeless(recorded) == _timeless(now)


def _timeless(entry: NetEntry) -> object:
    if isinstance(entry, EndFired | PhaseFired) and entry.error is not None and entry.error.code in BY_TIME:
        entry = entry._replace(error=ImError("", code=entry.error.code))
    return NET_ENTRY.content(entry)


def transition_of(entry: NetEntry | None) -> str:
    """Return the transition of an entry; empty: none."""
    return entry.transition if isinstance(entry, TransitionFired | EndFired | PhaseFired) else ""


def shown(entry: NetEntry) -> str:
    """Return an entry in words."""
    match entry:
        case TransitionFired(name) | EndFired(_, name, None):
            return f"{name} fires"
        case EndFired(_, name, error) | PhaseFired(_, name, error):
            return f"{name} fires: {told_of(error)}"
        case ActivityEnded(number, error, _, data):
            left = f" and leaves {left_of(data)}" if data is not None else ""
            return f"action {number} ends {told_of(error)}{left}"
        case MessageBuilt(number, data):
            return f"what builds the message of action {number} leaves {left_of(data)}"
    return NET_ENTRY.encode(entry)[:200]


def left_of(data: JobData | JobChange | None) -> dict[str, object] | None:
    """Return the results of an action, by name."""
    return data and {name: value for name, value in data._asdict().items() if value is not None}


def told_of(error: ImError | None) -> str:
    """Return the end of an action, in words."""
    return "well" if error is None else f"with failure {error.code}: {error.message}"


def reply_difference(recorded: Reply, now: Reply) -> str:
    """Return the difference of two ends of an action; empty for equal ones, up to durations."""
    then, again = encode_error(recorded.error), encode_error(now.error)
    if then != again and not (then and again and then[0] == again[0] and then[0] in BY_TIME):
        return "its function ends otherwise"
    told = first_difference(recorded.results, json.loads(encode_json(now.results)))
    return f"its answer is kept otherwise: {told}" if told else ""
