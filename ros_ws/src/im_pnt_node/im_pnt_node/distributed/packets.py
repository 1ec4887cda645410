"""Messages between nets of different processes, and the packets, as lines of JSON.

A packet is ``[sender, epoch, journal, receiver, known, base, ack, message, ...]``: ``journal`` is 1 if the sender keeps
one; ``known`` the receiver's epoch as the sender knows it (0: never heard); ``base`` the first number that was not
acknowledged to the sender; ``ack`` is 0 or ``[number, [[refused number, why], ...]]``: everything up to that number was
taken, but for what was refused; or 1: the sender has believed ``known``, which is later than the life in which it hears
the receiver now. A message is its number and what :func:`encode_message` writes.

An *epoch* names a life of a process: when it began, and a secret of 64 bits (:func:`new_epoch`). It is told to nobody
but those whom the process writes to, so a packet with the right ``known`` comes from one of them. Any other packet
changes nothing: it is answered with the epoch that it claims, so that an honest sender learns and tries again.
"""

import enum
import functools
import json
import secrets
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from im_core.clock import wall
from im_core.errors import ImError
from im_pnt.errors import decode_error, encode_error

MOST_NUMBER = 2**62
"""Numbers of messages and commands are smaller."""
SECRET_BITS = 64
MOST_EPOCH = 2 ** (64 + SECRET_BITS)
"""Epochs are smaller: microseconds since 1970, and below them the secret."""

_HEAD = 7
REMEMBERED = 1
MOST_NAME = 200
"""Characters of the name of a process."""

_NOTHING: Mapping[str, object] = MappingProxyType({})
_encode = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode


class MessageKind(enum.IntEnum):
    """Kind of a message."""

    TOKEN = 0
    REQUEST = 1
    REPLY = 2
    VOID = 3
    """In the place of a message that nobody needs any more."""
    TIDING = 4
    """What becomes of a job whose tokens have crossed."""


_TOKEN = MessageKind.TOKEN
_FULL = (MessageKind.REQUEST, MessageKind.REPLY, MessageKind.TOKEN, MessageKind.TIDING)
"""Messages that are written with all their fields."""


class Message(NamedTuple):
    """A token, request, reply or tiding for a net of another process.

    Attributes:
        kind: What it is.
        net: Net that gets it.
        place: Place that is marked.
        request_id: Of a request and its reply.
        caller_net: Net that asks, for a request; that sends, for a token of a job and a tiding.
        caller_transition: Transition that waits, for a request.
        command_id: Command it is done for.
        error: Why a request failed, for its reply; the failure that a token or a tiding tells of.
        payload: Arguments, results, or whose a token is, as plain JSON data.
    """

    kind: MessageKind
    net: str
    place: str
    request_id: str = ""
    caller_net: str = ""
    caller_transition: str = ""
    command_id: int = 0
    error: ImError | None = None
    payload: Mapping[str, object] = _NOTHING

    def __str__(self) -> str:
        if self.kind is MessageKind.TOKEN:
            return f"a token for {self.net}.{self.place}"
        if self.kind is MessageKind.REPLY:
            return f"the reply to request {self.request_id} of net {self.net}"
        if self.kind is MessageKind.TIDING:
            return f"word to net {self.net} of a job whose tokens have crossed"
        what = "the end of request" if self.payload.get("cancel") is True else "request"
        return "nothing" if self.kind is MessageKind.VOID else f"{what} {self.request_id} to net {self.net}"


VOID = Message(MessageKind.VOID, "", "")


@functools.lru_cache(maxsize=4096)
def token_message(net: str, place: str) -> Message:
    """Return the message of a token for a place of a net."""
    return Message(_TOKEN, net, place)


def encode_message(message: Message) -> str:
    """Write a message as the inside of a JSON list; a token without a job is the kind, net and place, and no more.

    Raises:
        TypeError: The payload is not JSON data.
        ValueError: Likewise.
    """
    if message.kind is _TOKEN and not message.payload:
        return _encode_token(message.net, message.place)
    kind, net, place, request_id, caller_net, caller_transition, command_id, error, payload = message
    names = (net, place, request_id, caller_net, caller_transition)
    return _encode([int(kind), *names, command_id, encode_error(error), dict(payload)])[1:-1]


def numbered(number: int, message: Message) -> str:
    """Write a message with the number in a stream, as JSON.

    Raises:
        TypeError: The payload is not JSON data.
        ValueError: Likewise.
    """
    return f"[{number},{encode_message(message)}]"


@functools.lru_cache(maxsize=4096)
def _encode_token(net: str, place: str) -> str:
    return f"0,{_encode(net)},{_encode(place)}"


def decode_message(fields: list[object]) -> Message:
    """Read a message.

    Args:
        fields: What :func:`encode_message` wrote, read as JSON.

    Raises:
        ValueError: It is none.
    """
    if len(fields) == 3 and fields[0] == 0:
        _, net, place = fields
        if isinstance(net, str) and isinstance(place, str):
            return Message(_TOKEN, net, place)
    match fields:
        case [
            int(kind), str(net), str(place), str(request), str(caller), str(transition), int(command), error, dict(data)
        ]:  # fmt: skip
            if kind in _FULL and is_number(command):
                reason = decode_error(error)
                return Message(MessageKind(kind), net, place, request, caller, transition, command, reason, data)
            if kind == MessageKind.VOID:
                return VOID
    raise ValueError(f"{str(fields)[:200]} is no message")


def is_number(value: object) -> bool:
    """Whether something is a number as messages and commands have, 0 included."""
    return type(value) is int and 0 <= value < MOST_NUMBER


def is_epoch(value: object) -> bool:
    """Whether something is the epoch of a life, or 0 for none."""
    return type(value) is int and 0 <= value < MOST_EPOCH


def new_epoch(after: int = 0) -> int:
    """Return an unguessable epoch for an incarnation from now on.

    Args:
        after: Epoch of an earlier life, which it is later than even if the clock has gone back.
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

    Args:
        text: The line.
        receiver: Name of the process that reads.

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
