"""Messages between nets of different processes, and how they are written down."""

import enum
import functools
import json
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from im_core.errors import ImError

MOST_NUMBER = 2**62
"""Numbers of messages, commands and epochs are smaller."""

_NOTHING: Mapping[str, object] = MappingProxyType({})
_encode = json.JSONEncoder(separators=(",", ":")).encode


class Kind(enum.IntEnum):
    """What a message is."""

    TOKEN = 0
    REQUEST = 1
    REPLY = 2
    VOID = 3
    """In the place of a message that nobody needs any more."""


_TOKEN = Kind.TOKEN


class Message(NamedTuple):
    """A token, request or reply for a net of another process.

    Attributes:
        kind: What it is.
        net: Net that gets it.
        place: Place that is marked.
        request_id: Of a request and its reply.
        caller_net: Net that asks, for a request.
        caller_transition: Transition that waits, for a request.
        command_id: Command it is done for.
        error: Why a request failed, for its reply.
        payload: Arguments or results, as plain JSON data.
    """

    kind: Kind
    net: str
    place: str
    request_id: str = ""
    caller_net: str = ""
    caller_transition: str = ""
    command_id: int = 0
    error: ImError | None = None
    payload: Mapping[str, object] = _NOTHING

    def __str__(self) -> str:
        if self.kind is Kind.TOKEN:
            return f"a token for {self.net}.{self.place}"
        if self.kind is Kind.REPLY:
            return f"the reply to request {self.request_id} of net {self.net}"
        what = "the end of request" if self.payload.get("cancel") is True else "request"
        return "nothing" if self.kind is Kind.VOID else f"{what} {self.request_id} to net {self.net}"


VOID = Message(Kind.VOID, "", "")


@functools.lru_cache(maxsize=4096)
def token_message(net: str, place: str) -> Message:
    """Returns a token for a place of a net."""
    return Message(_TOKEN, net, place)


def encode_message(message: Message) -> str:
    """Writes a message as the inside of a JSON list; a token is its kind, net and place, and no more.

    Raises:
        TypeError: The payload is not JSON data.
        ValueError: Likewise.
    """
    if message.kind is _TOKEN:
        return _encode_token(message.net, message.place)
    kind, net, place, request_id, caller_net, caller_transition, command_id, error, payload = message
    names = (net, place, request_id, caller_net, caller_transition)
    return _encode([int(kind), *names, command_id, encode_error(error), dict(payload)])[1:-1]


@functools.lru_cache(maxsize=4096)
def _encode_token(net: str, place: str) -> str:
    return f"0,{_encode(net)},{_encode(place)}"


def decode_message(fields: list[object]) -> Message:
    """Reads a message.

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
            if kind in (Kind.REQUEST, Kind.REPLY) and is_number(command):
                reason = decode_error(error)
                return Message(Kind(kind), net, place, request, caller, transition, command, reason, data)
            if kind == Kind.VOID:
                return VOID
    raise ValueError(f"{str(fields)[:200]} is no message")


def is_number(value: object) -> bool:
    """Whether something is a number as messages, commands and epochs have, 0 included."""
    return type(value) is int and 0 <= value < MOST_NUMBER


def encode_error(error: ImError | None) -> list[object] | None:
    """Writes an error as JSON data; facts that are none are written as text."""
    if error is None:
        return None
    facts: object = json.loads(json.dumps(error.facts, default=str, skipkeys=True))
    return [error.code, error.message, facts]


def decode_error(content: object) -> ImError | None:
    """Reads an error.

    Raises:
        ValueError: It is none.
    """
    match content:
        case None:
            return None
        case [str(code), str(message), dict(facts)]:
            return ImError.restored(code, message, facts)
    raise ValueError(f"{str(content)[:200]} is no error")
