"""Messages between nets of different processes, and the packets, as lines of JSON.

A packet is ``[sender, epoch, journal, receiver, known, base, ack, message, ...]``: ``journal`` is 1 if the sender keeps
one; ``known`` the receiver's epoch as the sender knows it (0: never heard); ``base`` the first number that was not
acknowledged to the sender; ``ack`` is 0 or ``[number, [[refused number, why], ...]]``: everything up to that number was
taken, but for what was refused; or 1: the sender has believed ``known``, which is later than the incarnation in which
it hears the receiver now. A message is ``[number, net, event]``, the event as :mod:`.codec` writes it.

An *epoch* names an incarnation of a process: when it began, and a secret of 64 bits (:func:`new_epoch`). It is told to
nobody but those whom the process writes to, so a packet with the right ``known`` comes from one of them. Any other
packet changes nothing: it is answered with the epoch that it claims, so that an honest sender learns and tries again.
"""

import functools
import json
import secrets
from dataclasses import replace
from typing import NamedTuple

from im_core.clock import wall
from im_pnt.errors import NetError
from im_pnt.execution.events import (
    JobUpdate,
    JobUpdateArrived,
    RequestArrived,
    RequestCancelled,
    RequestHeld,
    TokenArrived,
)
from im_pnt.execution.jobs import TokenContext
from im_pnt_node.distributed.codec import Codec
from im_pnt_node.distributed.entries import Json, ReplyArrived

MOST_NUMBER = 2**62
"""Numbers of messages and commands are smaller."""
SECRET_BITS = 64
MOST_EPOCH = 2 ** (64 + SECRET_BITS)
"""Epochs are smaller: microseconds since 1970, and below them the secret."""

_HEAD = 7
REMEMBERED = 1
MOST_NAME = 200
"""Characters of the name of a process."""


class Message(NamedTuple):
    """A message to a net of another process.

    Attributes:
        net: Net that gets it.
        event: Event of that net; None: nothing, in the place of a message that nobody needs any more.
    """

    net: str
    event: TokenArrived | JobUpdateArrived | RequestArrived | RequestCancelled | RequestHeld | ReplyArrived | None

    @property
    def request_id(self) -> str:
        """Name of the request that it is about; empty: none."""
        match self.event:
            case RequestArrived(request):
                return request.id
            case RequestCancelled(request_id) | RequestHeld(request_id) | ReplyArrived(request_id):
                return request_id
        return ""

    def __str__(self) -> str:
        match self.event:
            case TokenArrived(place):
                return f"a token for {self.net}.{place}"
            case ReplyArrived(request_id):
                return f"the reply to request {request_id} of net {self.net}"
            case JobUpdateArrived():
                return f"word to net {self.net} of a job whose tokens have crossed"
            case RequestCancelled(request_id):
                return f"the end of request {request_id} to net {self.net}"
            case None:
                return "nothing"
        return f"request {self.request_id} to net {self.net}"


VOID = Message("", None)
_MESSAGE: Codec[Message] = Codec(Message, "message")


@functools.lru_cache(maxsize=4096)
def token_message(net: str, place: str) -> Message:
    """Return the message of a token for a place of a net."""
    return Message(net, TokenArrived(place, 1))


def with_hold(message: Message, held: bool) -> Message:
    """Return a not yet taken message, adapted to the job's pause or release.

    What is done for nobody is as it was: nobody could resume it.
    """
    match message.event:
        case JobUpdateArrived(update=JobUpdate.HELD | JobUpdate.RELEASED) as told:
            return Message(message.net, replace(told, update=JobUpdate.HELD if held else JobUpdate.RELEASED))
        case TokenArrived(place, count, TokenContext() as context):
            return Message(message.net, TokenArrived(place, count, replace(context, held=held)))
        case RequestArrived(request, was_held) if was_held or request.command.id != 0:
            return Message(message.net, RequestArrived(request, held))
        case RequestHeld(request_id):
            return Message(message.net, RequestHeld(request_id, held))
    return message


def encode_message(message: Message) -> str:
    """Write a message as the inside of a JSON list.

    Raises:
        NetError: JSON cannot carry a part of it.
    """
    event = message.event
    if isinstance(event, TokenArrived) and event.context is None:
        return _encode_token(message.net, event.place)
    return _MESSAGE.encode(message)[1:-1]


def numbered(number: int, message: Message) -> Json:
    """Write a message with the number in a stream.

    Raises:
        NetError: JSON cannot carry a part of it.
    """
    return Json(f"[{number},{encode_message(message)}]")


@functools.lru_cache(maxsize=4096)
def _encode_token(net: str, place: str) -> str:
    return _MESSAGE.encode(token_message(net, place))[1:-1]


def decode_message(fields: list[object]) -> Message:
    """Read a message.

    Args:
        fields: What :func:`encode_message` wrote, read as JSON.

    Raises:
        NetError: It is none.
    """
    message = _MESSAGE.decode(fields)
    match message.event:
        case TokenArrived(_, 1, None):
            return message
        case TokenArrived(_, 1, TokenContext(owner)):
            number = owner.command.id
        case RequestArrived(request):
            number = request.command.id
        case TokenArrived():
            raise NetError(f"{str(fields)[:200]} is no message: it is not one token")
        case _:
            return message
    if not is_number(number):
        raise NetError(f"{str(fields)[:200]} is no message: its command is none")
    return message


def is_number(value: object) -> bool:
    """Whether something is a number as messages and commands have, 0 included."""
    return type(value) is int and 0 <= value < MOST_NUMBER


def is_epoch(value: object) -> bool:
    """Whether something is the epoch of an incarnation, or 0 for none."""
    return type(value) is int and 0 <= value < MOST_EPOCH


def new_epoch(after: int = 0) -> int:
    """Return an unguessable epoch for an incarnation from now on.

    Args:
        after: Epoch of an earlier incarnation, which it is later than even if the clock has gone back.
    """
    return max(int(wall() * 1e6), began_at(after) + 1) << SECRET_BITS | secrets.randbits(SECRET_BITS)


def began_at(epoch: int) -> int:
    """Return the beginning of an incarnation by the clock of the process [us since 1970]."""
    return epoch >> SECRET_BITS


class Packet(NamedTuple):
    """Packet with unchecked acknowledgement and messages."""

    sender: str
    epoch: int
    journal: bool
    known: int
    base: int
    ack: object
    messages: list[object]

    def head(self, receiver: str) -> str:
        """Return the usual spelling of the beginning of a packet, up to ``base``."""
        return f'["{self.sender}",{self.epoch},{int(self.journal)},"{receiver}",{self.known},{self.base}'


def read_packet(text: str, receiver: str) -> Packet | str:
    """Read a packet.

    Returns:
        The packet; or why it is none, empty if it is for another process.
    """
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        return f"it is not JSON: {error}"
    if not isinstance(content, list) or len(content) < _HEAD:
        return f"it makes no sense: {text[:MOST_NAME]}"
    sender, epoch, journal, to, known, base, ack = content[:_HEAD]
    if to != receiver:
        return ""
    if not (isinstance(sender, str) and sender.isascii() and sender.isidentifier() and len(sender) <= MOST_NAME):
        return f"{str(sender)[:MOST_NAME]!r} is no name of a process"
    if not (is_epoch(epoch) and is_epoch(known) and is_number(base) and epoch and base):
        return f"its numbers make no sense: {text[:MOST_NAME]}"
    return Packet(sender, epoch, journal == 1, known, base, ack, content[_HEAD:])
