"""A ``TokenPacket`` as the bytes that travel: CDR of its one string. Nothing else need be made of it on the way."""

from im_pnt.errors import NetError

_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_HEAD = 8
"""Bytes before the text: how it is encoded, and the length of the text with the zero that ends it."""


def encode_packet(text: str) -> bytes:
    """Writes a packet."""
    data = text.encode()
    return b"%b%b%b\0" % (_LITTLE_ENDIAN, (len(data) + 1).to_bytes(4, "little"), data)


def decode_packet(data: bytes) -> str:
    """Reads a packet.

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
