"""Frequent messages as the bytes in transit (CDR), without objects on the way.

A ``TokenPacket`` is one string. Of the firings of a transition only stamp, number, duration and progress differ, as
long as nothing belongs to its tokens: the rest is made once.
"""

import functools
import struct

from im_pnt.errors import NetError
from im_pnt.execution.notification import Firing

_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_HEAD = 8
"""Bytes before the text: how it is encoded, and the length of the text with the zero that ends it."""


def encode_packet(text: str) -> bytes:
    """Write a packet."""
    data = text.encode()
    return b"%b%b%b\0" % (_LITTLE_ENDIAN, (len(data) + 1).to_bytes(4, "little"), data)


def decode_packet(data: bytes) -> str:
    """Read a packet.

    Raises:
        NetError: It is none.
    """
    if len(data) <= _HEAD or data[0] or data[1] > 1:
        raise NetError(f"{bytes(data[:32])!r} ({len(data)} bytes) is no CDR of a packet")
    end = _HEAD - 1 + int.from_bytes(data[4:_HEAD], "little" if data[1] else "big")
    if not _HEAD <= end < len(data) or data[end]:
        raise NetError(f"a packet of {len(data)} bytes says that its text ends at byte {end}")
    try:
        return data[_HEAD:end].decode()
    except UnicodeDecodeError as error:
        raise NetError(f"a packet is no text: {error}") from error


def encode_firing(firing: Firing, seconds: int, nanoseconds: int) -> bytes:
    """Write a ``Firing``."""
    net, transition, sequence, phase, symbol, command_id, message, duration, progress = firing
    names, rest = _unchanging(net, transition, phase, symbol, command_id, message)
    stamp = _STAMP(seconds, nanoseconds)
    return b"".join((_LITTLE_ENDIAN, stamp, names, _SEQUENCE(sequence), rest, _FRACTIONS(duration, progress)))


_STAMP, _SEQUENCE, _FRACTIONS = struct.Struct("<iI").pack, struct.Struct("<Q").pack, struct.Struct("<dd").pack


@functools.lru_cache(maxsize=4096)
def _unchanging(
    net: str, transition: str, phase: int, symbol: str, command_id: int, message: str
) -> tuple[bytes, bytes]:
    """Return the constant bytes of a firing between stamp and number, and between number and duration."""
    names = _padded(_string(net), 4) + _string(transition)
    rest = _padded(bytes((phase,)), 4) + _string(symbol)
    return _padded(names, 8), _padded(_padded(rest, 8) + _SEQUENCE(command_id) + _string(message), 8)


def _string(text: str) -> bytes:
    data = text.encode()
    return b"%b%b\0" % ((len(data) + 1).to_bytes(4, "little"), data)


def _padded(data: bytes, size: int) -> bytes:
    """Pad to a multiple of a size; stamp and number behind the padding are 8 bytes long and aligned."""
    return data + bytes(-len(data) % size)
