"""Recorded entries of a net, beside the present ones."""

import json
from collections.abc import Sequence

from im_core.errors import DataError, ImError
from im_pnt.errors import decode_error, encode_error
from im_pnt.execution.jobs import Reply
from im_pnt_node.journal.log import encode_json
from im_pnt_node.rerun.difference import first_difference
from im_pnt_node.rerun.stream import Turn

#: Kinds of entries that arrive from outside; the others are what the net makes of them.
INPUTS = frozenset(
    (
        "command",
        "cancel",
        "hold",
        "request",
        "request_cancelled",
        "request_held",
        "token",
        "tiding",
        "node_forgotten",
        "ended",
        "mode",
        "pause",
    )
)
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
        self.recorded: list[tuple[list[object], Turn]] = []
        self.reached = self.seen = 0
        self._early: set[int] = set()

    def advance(self, now: list[object]) -> bool:
        """Note a repeated entry; return whether the entry was an expected one.

        What makes a message may be done a little earlier than it was: the loop had something else to do first.
        """
        rank = self.reached
        if now[0] == "built":
            later = (each for each in range(self.reached, len(self.recorded)) if self.recorded[each][0] == now)
            rank = next(later, rank)
        if rank >= len(self.recorded) or not _same(self.recorded[rank][0], now):
            return False
        self._early.add(rank)
        while self.reached in self._early:
            self._early.remove(self.reached)
            self.reached += 1
        return True

    def next(self) -> list[object] | None:
        """Return the next expected entry; None: there is none."""
        return self.recorded[self.reached][0] if self.reached < len(self.recorded) else None


def plain(content: list[object]) -> list[object]:
    """Return an entry as read from a bag."""
    copy = json.loads(encode_json(content))
    assert isinstance(copy, list)
    return copy


def error_of(content: object) -> ImError | None:
    """Return a recorded error.

    Raises:
        DataError: It is none.
    """
    try:
        return decode_error(content)
    except ValueError as error:
        raise DataError(str(error)) from error


def _same(recorded: list[object], now: list[object]) -> bool:
    """Return whether entries are equal, up to the duration in the sentence of a time-out."""
    if recorded == now:
        return True
    match recorded, now:
        case ["end" | "phase", *_], ["end" | "phase", *_] if len(recorded) == len(now):
            rank = 3
            then, again = recorded[rank], now[rank]
            same = recorded[:rank] == now[:rank] and recorded[rank + 1 :] == now[rank + 1 :]
            if same and isinstance(then, list) and isinstance(again, list):
                return then[0] == again[0] and then[0] in BY_TIME
    return False


def transition_of(content: Sequence[object]) -> str:
    """Return the transition of an entry; empty: none."""
    match content:
        case ["fire", str(name), *_] | ["end" | "phase", _, str(name), *_]:
            return name
    return ""


def shown(content: Sequence[object]) -> str:
    """Return an entry in words."""
    match content:
        case ["fire", str(name), *_]:
            return f"{name} fires"
        case ["end", _, str(name), error, *_]:
            return f"{name} fires" + (f": {told_of(error_of(error))}" if error else "")
        case ["phase", _, str(name), error]:
            return f"{name} fires: {told_of(error_of(error))}"
        case ["ended", int(number), error, _, *data]:
            left = f" and leaves {left_of(data[0])}" if data else ""
            return f"action {number} ends {told_of(error_of(error))}{left}"
        case ["built", int(number), data]:
            return f"what builds the message of action {number} leaves {left_of(data)}"
    return str(content)[:200]


def left_of(data: object) -> object:
    """Return the results of an action, by name."""
    return dict(zip(("memory", "results", "progress"), data, strict=False)) if isinstance(data, list) else data


def told_of(error: ImError | None) -> str:
    """Return the end of an action, in words."""
    return "well" if error is None else f"with failure {error.code}: {error.message}"


def reply_difference(recorded: Reply, now: Reply) -> str:
    """Return the difference of two ends of an action; empty for equal ones, up to durations."""
    then, again = encode_error(recorded.error), encode_error(now.error)
    if then != again and not (then and again and then[0] == again[0] and then[0] in BY_TIME):
        return "its function ends otherwise"
    if plain([recorded.results]) != plain([now.results]):
        return f"its answer is kept otherwise: {first_difference(plain([recorded.results]), plain([now.results]))}"
    return ""
