"""The log of a journal: a file of records, with a header, a snapshot and later events; replaced by a new file.

A record is a line with its length and a checksum that covers all records before it, ``00000042 9ae0daaf [...]``: bytes
of the body in decimal, CRC-32 in hexadecimal, the body (JSON without line breaks), a line feed. A process that is
killed while it writes leaves a beginning of its last record, and that never contains the line feed. A computer that
loses its power may have lengthened the file and not filled all sectors of what was not synchronised; no record contains
a zero byte. Whatever else does not fit is damage.

``000007.journal`` is written as ``000007.new`` and synchronised before it is renamed, and ``000006.journal`` is removed
only then: at every instant the last ``.journal`` is whole.
"""

import contextlib
import enum
import json
import re
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from im_core.clock import stamp_name
from im_pnt.errors import DamagedJournalError, JournalError
from im_pnt_node.distributed.codec import encode_json
from im_pnt_node.journal.folder import Files, Growing

FORMAT = "im_pnt journal"
VERSION = 3
HEAD_BYTES = 18
_SECTOR = 512
_MOST_DIGITS = 8
MOST_BYTES = 10**_MOST_DIGITS - 1
"""Longest body of a record [bytes]."""
_HEAD = re.compile(rb"[0-9]{8} [0-9a-f]{8} ")
_NAME = re.compile(r"(\d{6,})\.(journal|new)")
DISCARD = "move the journal aside with scripts/im pnt journal discard NODE and begin anew"

# Records.


@dataclass(frozen=True, slots=True)
class Record:
    """Record of a log.

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
    """Content of a file.

    Attributes:
        records: Its whole records.
        size: Where the last whole record ends [bytes].
        checksum: That of the last whole record; the next continues it.
        torn: Bytes behind it, of what was being written when the process ended or the computer lost its power.
    """

    records: tuple[Record, ...]
    size: int
    checksum: int
    torn: int


def frame(body: bytes, checksum: int) -> tuple[bytes, int]:
    """Make a record.

    Args:
        body: JSON without line feeds, at most :data:`MOST_BYTES`.
        checksum: Checksum of the record before it, 0 for the first.

    Returns:
        The bytes to write, and the record's own checksum.
    """
    checksum = zlib.crc32(body, checksum)
    return b"%08d %08x %b\n" % (len(body), checksum, body), checksum


def scan(data: bytes, file: str, sync: "Sync") -> Scan:
    """Read all records of a file.

    Args:
        data: Content of the file.
        file: Its name, for messages.
        sync: How it was written: a loss of power takes the last record at most, or more.

    Raises:
        DamagedJournalError: A record is damaged; names file, offset and number of the record.
    """
    records: list[Record] = []
    offset, checksum = 0, 0
    while offset < len(data):
        end = data.find(b"\n", offset)
        line = data[offset:end] if end >= 0 else data[offset:]
        why = _damage(line, checksum, torn=end < 0)
        last = end < 0 or end + 1 == len(data)
        if why and (last or sync is Sync.OS) and _unfilled(data, offset):
            return Scan(tuple(records), offset, checksum, len(data) - offset)
        if why:
            number = len(records) + 1
            raise DamagedJournalError(
                f"{file}: record {number} at byte {offset} is damaged: {why}", file=file, offset=offset, record=number
            )
        if end < 0:
            return Scan(tuple(records), offset, checksum, len(line))
        body = line[HEAD_BYTES:]
        checksum = int(line[9:17], 16)
        records.append(Record(len(records) + 1, offset, body))
        offset = end + 1
    return Scan(tuple(records), offset, checksum, 0)


def _damage(line: bytes, checksum: int, torn: bool) -> str:
    """Return the fault of a line as a record or the beginning; empty for a good one."""
    head = line[:HEAD_BYTES]
    if not _HEAD.match(head) and not all(_fits(byte, place) for place, byte in enumerate(head)):
        return f"it begins with {bytes(head)!r}, not with a length and a checksum"
    if torn:
        full = len(head) == HEAD_BYTES and len(line) - HEAD_BYTES > int(head[:_MOST_DIGITS])
        return "it does not end where it should" if full else ""
    if len(head) < HEAD_BYTES or len(line) - HEAD_BYTES != int(head[:_MOST_DIGITS]):
        return f"it has {max(0, len(line) - HEAD_BYTES)} bytes, and its length says {bytes(head[:_MOST_DIGITS])!r}"
    found = zlib.crc32(line[HEAD_BYTES:], checksum)
    return "" if head[9:17] == b"%08x" % found else f"its checksum is {found:08x}, not {head[9:17].decode()}"


def _unfilled(data: bytes, offset: int) -> bool:
    """Return whether a sector behind an offset was not filled: an unfilled sector ends with a zero byte."""
    return b"\0" in data[offset | _SECTOR - 1 :: _SECTOR] + data[-1:]


def _fits(byte: int, place: int) -> bool:
    if place in (_MOST_DIGITS, HEAD_BYTES - 1):
        return byte == 0x20
    return byte in (b"0123456789" if place < _MOST_DIGITS else b"0123456789abcdef")


# The log.


class Sync(enum.Enum):
    """When a record counts as written."""

    OS = "os"
    """The operating system has it: it survives the death of the process."""
    DISK = "disk"
    """The disk has it: it survives the loss of power too."""


@dataclass(frozen=True, slots=True)
class Recovered:
    """Content of a log at the opening.

    Attributes:
        file: The file, for messages.
        header: Its header.
        state: The snapshot it begins with.
        batches: What was written since, batch by batch; each was written whole.
        size: Where the last whole batch ends [bytes].
        torn: Bytes of what was not written whole, and was dropped; 0 if there was nothing.
    """

    file: str
    header: Mapping[str, object]
    state: Mapping[str, object]
    batches: tuple[tuple[Record, list[object]], ...]
    size: int
    torn: int


class Log:
    """Log, open for writing.

    Args:
        files: Its folder, locked by this process.
        sync: When a record counts as written.
    """

    def __init__(self, files: Files, sync: Sync) -> None:
        self._files, self._sync = files, sync
        self._file: Growing | None = None
        self._number = 0
        self._checksum = 0
        self._broken = ""
        self.size = 0

    def recover(self) -> Recovered | None:
        """Read the content of the folder, and go on writing there.

        Returns:
            What was found; None if there is no log yet: begin with :meth:`replace`.

        Raises:
            DamagedJournalError: It is damaged.
            JournalError: It cannot be read, or was written by another version.
        """
        try:
            name = _newest(self._files)
            if name is None:
                return None
            found, recovered = _read(self._files, name, self._sync)
            self._file = self._files.extend(name, found.size)
        except OSError as error:
            raise self._failed("read", error) from error
        self._number = int(name.partition(".")[0])
        self._checksum, self.size = found.checksum, found.size
        return recovered

    def replace(self, header: Mapping[str, object], state: Mapping[str, object]) -> None:
        """Begin a new file with a snapshot; older records are not needed any more.

        Raises:
            JournalError: It cannot be written; the old file is still in use.
        """
        head = {"format": FORMAT, "version": VERSION, **header}
        first, checksum = self._framed(_body(head, self._files.name), 0)
        second, checksum = self._framed(_body(state, self._files.name), checksum)
        name = f"{self._number + 1:06d}"
        if self._broken:
            raise JournalError(self._broken, file=self._files.name)
        file: Growing | None = None
        try:
            file = self._files.create(f"{name}.new")
            file.write(first + second)
            file.sync()
            self._files.rename(f"{name}.new", f"{name}.journal")
        except OSError as error:
            if file is not None:
                file.close()
                for end in ("new", "journal"):  # what was begun would keep a full disk full, or count at the next start
                    with contextlib.suppress(OSError):
                        self._files.remove(f"{name}.{end}")
            raise self._failed("written", error) from error
        if self._file is not None:
            self._file.close()
        self._file, self._checksum, self.size = file, checksum, len(first) + len(second)
        self._number += 1
        self._remove_others()

    def append(self, batch: str) -> None:
        """Write a batch, whole or not at all.

        Args:
            batch: JSON list of entries, without line feeds.

        Raises:
            JournalError: It was not written, and may be tried again; or the disk has failed, and nothing can be written
                any more.
        """
        assert self._file is not None
        if self._broken:
            raise JournalError(self._broken, file=self._files.name)
        data, checksum = self._framed(batch.encode(), self._checksum)
        try:
            self._file.write(data)
        except OSError as error:
            raise self._failed("written", error) from error
        self._checksum = checksum
        self.size += len(data)
        if self._sync is Sync.DISK:
            self._synchronise()

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _framed(self, body: bytes, checksum: int) -> tuple[bytes, int]:
        if len(body) > MOST_BYTES:
            text = f"{self._files.name}: a record of {len(body)} bytes; at most {MOST_BYTES}"
            raise JournalError(text, file=self._files.name)
        return frame(body, checksum)

    def _synchronise(self) -> None:
        assert self._file is not None
        try:
            self._file.sync()
        except OSError as error:  # what the disk holds now is not known, and a second try would not tell
            self._broken = f"{self._files.name}: the disk has failed: {error}; nothing is written any more"
            raise JournalError(self._broken, file=self._files.name) from error

    def _remove_others(self) -> None:
        with contextlib.suppress(OSError):  # they are not read any more; the next time is early enough
            for name in self._files.names():
                match = _NAME.fullmatch(name)
                if match and (int(match[1]) < self._number or match[2] == "new"):
                    self._files.remove(name)

    def _failed(self, what: str, error: OSError) -> JournalError:
        return JournalError(f"{self._files.name}: the journal cannot be {what}: {error}", file=self._files.name)


def look(files: Files) -> Recovered | None:
    """Read a log during the writing of another process; nothing is changed.

    Returns:
        What it holds; None if there is none.

    Raises:
        JournalError: It cannot be read, is damaged, or was written by another version.
    """
    try:
        name = _newest(files)
        return None if name is None else _read(files, name, Sync.OS)[1]
    except OSError as error:
        raise JournalError(f"{files.name}: the journal cannot be read: {error}", file=files.name) from error


def _newest(files: Files) -> str | None:
    """Return the name of the last whole file."""
    names = [match for name in files.names() if (match := _NAME.fullmatch(name)) and match[2] == "journal"]
    return max(names, key=lambda match: int(match[1]))[0] if names else None


def _read(files: Files, name: str, sync: Sync) -> tuple[Scan, Recovered]:
    file = f"{files.name}/{name}"
    found = scan(files.read(name), file, sync)
    return found, _parse(found, file)


def discard(files: Files, stamp: Callable[[], str] = stamp_name) -> str | None:
    """Move a journal aside, so the next start begins anew; nothing is deleted.

    Args:
        files: Its folder; no process may be using it.
        stamp: Names the time.

    Returns:
        Name of the folder inside, where it is now; None if there was none.

    Raises:
        JournalError: A process is using it, or it cannot be moved.
    """
    files.lock()
    try:
        return set_aside(files, "discarded", stamp)
    finally:
        files.unlock()


def set_aside(files: Files, why: str, stamp: Callable[[], str] = stamp_name) -> str | None:
    """Move a journal aside; nothing is deleted.

    Args:
        files: Its folder, locked by this process, which has none of its files open.
        why: A word, with which the name of the folder begins where it is kept.
        stamp: Names the time.

    Returns:
        Name of that folder; None if there is no journal.

    Raises:
        JournalError: It cannot be moved.
    """
    try:
        names = [name for name in files.names() if _NAME.fullmatch(name)]
        if not names:
            return None
        aside = f"{why}-{stamp()}-{names[-1].partition('.')[0]}"
        files.move_aside(names, aside)
    except OSError as error:
        raise JournalError(f"{files.name}: the journal cannot be moved aside: {error}", file=files.name) from error
    return aside


def _body(content: Mapping[str, object], name: str) -> bytes:
    try:
        return encode_json(content).encode()
    except (TypeError, ValueError) as error:
        raise JournalError(f"{name}: the state cannot be written as JSON: {error}", file=name) from error


def _parse(found: Scan, file: str) -> Recovered:
    records = found.records
    if len(records) < 2:
        offset = records[0].offset + len(records[0].body) if records else 0
        raise _bad(file, len(records) + 1, offset, "it ends there, and every journal has a header and a snapshot")
    contents = [_loads(record, file) for record in records]
    header, state = contents[0], contents[1]
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise _foreign(file, f"its header is not one of an {FORMAT}")
    if header.get("version") != VERSION:
        raise _foreign(file, f"it has version {header.get('version')!r}, and version {VERSION} is read here")
    if not isinstance(state, dict):
        raise _bad(file, 2, records[1].offset, "the snapshot is not a JSON object")
    batches: list[tuple[Record, list[object]]] = []
    for record, batch in zip(records[2:], contents[2:], strict=True):
        if not isinstance(batch, list):
            raise _bad(file, record.number, record.offset, "it is not a JSON list of entries")
        batches.append((record, batch))
    return Recovered(file, header, state, tuple(batches), found.size, found.torn)


def _loads(record: Record, file: str) -> object:
    try:
        return json.loads(record.body)
    except ValueError as error:
        raise _bad(file, record.number, record.offset, f"it is not JSON: {error}") from error


def _bad(file: str, number: int, offset: int, why: str) -> DamagedJournalError:
    return DamagedJournalError(
        f"{file}: record {number} at byte {offset} cannot be used: {why}", file=file, offset=offset, record=number
    )


def _foreign(file: str, why: str) -> JournalError:
    """Return the error for a whole file of another program: a person must decide on the file."""
    return JournalError(
        f"{file}: {why}; nothing was started. Put the right file there, or {DISCARD}", file=file, offset=0, record=1
    )
