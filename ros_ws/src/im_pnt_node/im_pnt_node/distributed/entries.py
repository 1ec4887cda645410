"""Entries of an exchange in the journal (:data:`ExchangeEntry`), written before the effect."""

from typing import NamedTuple

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

    life: str


class TokenKept(NamedTuple):
    """Entry: a token is kept as undeliverable."""

    net: str
    place: str


ExchangeEntry = EventPosted | RequestAsked | RequestAnswered | RequestClosed | RequestsRenamed | TokenKept
