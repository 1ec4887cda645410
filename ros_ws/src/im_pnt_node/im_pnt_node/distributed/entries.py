"""Entries of an exchange and of a link in the journal, written before the effect."""

from typing import NamedTuple, NewType

from im_core.errors import ImError
from im_pnt.execution.events import (
    CommandHeld,
    JobUpdateArrived,
    NodeForgotten,
    RequestArrived,
    RequestCancelled,
    RequestHeld,
    TokenArrived,
)
from im_pnt.execution.journal_entries import ActivityEnded

Arrival = (
    TokenArrived | JobUpdateArrived | NodeForgotten | RequestArrived | RequestCancelled | RequestHeld | CommandHeld
)
Delivery = Arrival | ActivityEnded
"""An event for a net, as the net that takes it records it: so it is known when it was."""


class ReplyArrived(NamedTuple):
    """The reply to a request arrives from another process.

    Attributes:
        request_id: The request.
        error: Why it failed, None if it has not.
        results: What was done for it.
    """

    request_id: str
    error: ImError | None
    results: dict[str, object]


class EventPosted(NamedTuple):
    """An event was put into the inbox of a net."""

    net: str
    event: Delivery


class RequestAsked(NamedTuple):
    """A net has asked another one.

    Attributes:
        request_id: Name of the request.
        net: Net that asks.
        number: Number of its activity that waits.
        asked: Net that is asked.
        node: Node of that net, empty for one of the same process.
    """

    request_id: str
    net: str
    number: int
    asked: str
    node: str


class RequestAnswered(NamedTuple):
    """Entry: a request waits for the reply no more."""

    request_id: str


class RequestClosed(NamedTuple):
    """A request is not in work any more."""

    request_id: str


class RequestsRenamed(NamedTuple):
    """Entry: requests, and other names made from the incarnation of the process, change from here on."""

    incarnation: str


class TokenKept(NamedTuple):
    """Entry: a token is kept as undeliverable."""

    net: str
    place: str


ExchangeEntry = EventPosted | RequestAsked | RequestAnswered | RequestClosed | RequestsRenamed | TokenKept


# Of a link; ``node`` is the other process.

Json = NewType("Json", str)
"""JSON text, which is embedded as it is."""


class MessageSent(NamedTuple):
    """A message gets the next number of the stream to a process; ``text`` is both."""

    node: str
    number: int
    text: Json


class MessageTaken(NamedTuple):
    """The next message of a process was taken, or refused if ``refusal`` says why."""

    node: str
    number: int
    refusal: str


class MessagesAcknowledged(NamedTuple):
    """A process has acknowledged all messages up to a number."""

    node: str
    floor: int


class MessageRefused(NamedTuple):
    """A process has refused a message."""

    node: str
    number: int


class MessageVoided(NamedTuple):
    """Entry: an unacknowledged message is needed no more."""

    node: str
    number: int


class IncarnationBegun(NamedTuple):
    """Entry: a process is in another incarnation, with or without a journal."""

    node: str
    epoch: int
    journal: bool


class NumbersSkipped(NamedTuple):
    """Nothing up to a number is waited for any more."""

    node: str
    floor: int


class EpochRaised(NamedTuple):
    """Entry: the process is in another incarnation."""

    epoch: int


PeerEntry = (
    MessageSent
    | MessageTaken
    | MessagesAcknowledged
    | MessageRefused
    | MessageVoided
    | IncarnationBegun
    | NumbersSkipped
)
LinkEntry = PeerEntry | EpochRaised
