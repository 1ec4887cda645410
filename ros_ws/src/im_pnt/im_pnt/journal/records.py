"""Records of a journal file: a line each, with its length and a checksum that covers all records before it.

``00000042 9ae0daaf ["n","dispatcher",[...]]``: bytes of the body in decimal, CRC-32 in hexadecimal, the body (JSON
without line breaks), a line feed. A process that is killed while it writes leaves a beginning of its last record, and
that never contains the line feed; whatever else does not fit is damage.
"""

import zlib
from dataclasses import dataclass

from im_pnt.journal.errors import JournalError

HEAD_BYTES = 18
_MOST_DIGITS = 8
MOST_BYTES = 10**_MOST_DIGITS - 1
"""Longest body of a record [bytes]."""


@dataclass(frozen=True, slots=True)
class Record:
    """A record that was read.

    Attributes:
        number: Counts the records of the file from 1.
        offset: Where it begins [bytes].
        body: Its JSON.
    """

    number: int
    offset: int
    body: bytes


@dataclass(frozen=True, slots=True)
class Scan:
    """What a file holds.

    Attributes:
        records: Its whole records.
        size: Where the last whole record ends [bytes].
        checksum: That of the last whole record; the next continues it.
        torn: Bytes of the record that was being written when the process ended, 0 if none was.
    """

    records: tuple[Record, ...]
    size: int
    checksum: int
    torn: int


def frame(body: bytes, checksum: int) -> tuple[bytes, int]:
    """Makes a record.

    Args:
        body: JSON without line feeds, at most :data:`MOST_BYTES`.
        checksum: Checksum of the record before it, 0 for the first.

    Returns:
        The bytes to write, and the record's own checksum.
    """
    checksum = zlib.crc32(body, checksum)
    return b"%08d %08x %b\n" % (len(body), checksum, body), checksum


def scan(data: bytes, file: str) -> Scan:
    """Reads all records of a file.

    Args:
        data: Content of the file.
        file: Its name, for messages.

    Raises:
        JournalError: A record is damaged; names file, offset and number of the record.
    """
    records: list[Record] = []
    offset, checksum = 0, 0
    while offset < len(data):
        end = data.find(b"\n", offset)
        line = data[offset:end] if end >= 0 else data[offset:]
        why = _damage(line, checksum, torn=end < 0)
        if why:
            number = len(records) + 1
            raise JournalError(
                f"{file}: record {number} at byte {offset} is damaged: {why}; nothing was started. "
                "Restore the file, or move the journal aside with Journal.discard and begin anew",
                file=file,
                offset=offset,
                record=number,
            )
        if end < 0:
            return Scan(tuple(records), offset, checksum, len(line))
        body = line[HEAD_BYTES:]
        checksum = int(line[9:17], 16)
        records.append(Record(len(records) + 1, offset, body))
        offset = end + 1
    return Scan(tuple(records), offset, checksum, 0)


def _damage(line: bytes, checksum: int, torn: bool) -> str:
    """Why a line is no record, or no beginning of one; empty if it is."""
    if torn:
        line = line.rstrip(b"\0")  # a computer that lost its power may have lengthened the file, and not filled it
    head = line[:HEAD_BYTES]
    if not all(_fits(byte, place) for place, byte in enumerate(head)):
        return f"it begins with {bytes(head)!r}, not with a length and a checksum"
    if torn:
        full = len(head) == HEAD_BYTES and len(line) - HEAD_BYTES > int(head[:_MOST_DIGITS])
        return "it does not end where it should" if full else ""
    if len(head) < HEAD_BYTES or len(line) - HEAD_BYTES != int(head[:_MOST_DIGITS]):
        return f"it has {max(0, len(line) - HEAD_BYTES)} bytes, and its length says {bytes(head[:_MOST_DIGITS])!r}"
    found = zlib.crc32(line[HEAD_BYTES:], checksum)
    return "" if head[9:17] == b"%08x" % found else f"its checksum is {found:08x}, not {head[9:17].decode()}"


def _fits(byte: int, place: int) -> bool:
    if place in (_MOST_DIGITS, HEAD_BYTES - 1):
        return byte == 0x20
    return byte in (b"0123456789" if place < _MOST_DIGITS else b"0123456789abcdef")
