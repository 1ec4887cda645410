"""What an exchange tells its journal (:data:`ExchangeEntry`), before it is done."""

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
    """A request waits for its reply no more."""

    request_id: str


class RequestClosed(NamedTuple):
    """A request is not in work any more."""

    request_id: str


class RequestsRenamed(NamedTuple):
    """Requests, and what else has its name from the life of the process, are named otherwise from then on."""

    life: str


class TokenKept(NamedTuple):
    """A token is kept that no net wants."""

    net: str
    place: str


ExchangeEntry = EventPosted | RequestAsked | RequestAnswered | RequestClosed | RequestsRenamed | TokenKept
