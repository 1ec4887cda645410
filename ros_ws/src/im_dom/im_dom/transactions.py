"""List of required content of the object store's write-ahead log, in a file beside the store.

SQLite ends the replay of a write-ahead log at the first frame whose checksum is wrong, without a word. Against that,
each transaction is listed here when it is on the disk: its number, and the objects that it has changed. A line is a
checksum and JSON:

- ``["file", size, checksum]``: the file of the store, without its log;
- ``["moves"]``: the log is being moved into that file;
- ``[number, [[name, version, valid], ...]]``: a transaction; the version 0 is that of an object that was deleted.

The list is written to the operating system, and no disk is waited for: after a loss of power the list may lack its end,
never the log.
"""

import json
import os
import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from im_core.errors import DataError, StoreError
from im_core.files import read_bytes, write_whole


@dataclass(frozen=True)
class Change:
    """The newest state of an object by the list.

    Attributes:
        number: Of the transaction that changed the object.
        version: Of the object; 0: it was deleted.
        valid: Whether it may be used.
    """

    number: int
    version: int
    valid: bool


@dataclass
class Listed:
    """Content of a list of transactions.

    Attributes:
        file: Size and checksum of the file of the store; None: it was being written.
        last: Number of the last transaction.
        changes: The newest state of the objects that were changed, by name.
        fault: What is wrong with the list, a clause; empty if nothing is.
    """

    file: tuple[int, int] | None = None
    last: int = 0
    changes: dict[str, Change] = field(default_factory=dict)
    fault: str = ""


class TransactionList:
    """The list, open for writing.

    Args:
        path: Its file.
        size: Of the file of the store [byte].
        checksum: Of the file of the store.

    Attributes:
        size: Of the list [byte].

    Raises:
        StoreError: It cannot be written.
    """

    def __init__(self, path: Path, size: int, checksum: int) -> None:
        text = _line(["file", size, checksum])
        write_whole(path, text)
        self.size = len(text)
        self._unwritten = b""
        try:
            self._descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC)
        except OSError as error:
            raise StoreError.of("opened", path, error) from error

    def add(self, number: int, changed: Sequence[tuple[str, int, bool]]) -> None:
        """List a transaction; on a full disk the transaction is listed with a later one.

        Args:
            number: Of the transaction.
            changed: Name, version and validity of the objects that it changed.
        """
        self._write(_line([number, changed]))

    def begin_move(self) -> None:
        """Note the coming write to the file of the store; the note is on the disk at the return.

        Raises:
            OSError: The disk is full or has failed.
        """
        self._write(_line(["moves"]))
        if self._unwritten:
            raise OSError("the list of transactions cannot be written")
        os.fsync(self._descriptor)

    def close(self) -> None:
        """Close the file."""
        with suppress(OSError):  # it is closed all the same
            os.close(self._descriptor)

    def _write(self, line: bytes) -> None:
        self._unwritten += line
        try:
            written = os.pwrite(self._descriptor, self._unwritten, self.size)
        except OSError:  # what it lists is on the disk
            return
        if written == len(self._unwritten):
            self.size, self._unwritten = self.size + written, b""


def read_list(path: Path) -> Listed | None:
    """Read a list; None: there is none.

    A loss of power leaves zeros and a cut line at its end, which are no damage.
    """
    if not path.exists():
        return None
    listed = Listed()
    try:
        lines = read_bytes(path).split(b"\n")
    except DataError as error:
        listed.fault = f"its list of transactions cannot be read ({error.message})"
        return listed
    cut = lines.pop()
    known = [(number, _content(line), line.count(0) > 1) for number, line in enumerate(lines, 1)]
    known += [(len(known) + 1, None, False)] if _content(cut[:-1]) is not None else []  # its end of line was changed
    for number, content, torn in known:
        match content:
            case ["file", int(size), int(checksum)]:
                listed.file = size, checksum
            case ["moves"]:
                listed.file = None
            case [int(last), list(changed)]:
                listed.last = last
                listed.changes.update({name: Change(last, version, valid) for name, version, valid in changed})
            case _ if not torn:
                listed.fault = f"line {number} of its list of transactions is damaged"
    return listed


def _line(content: object) -> bytes:
    text = json.dumps(content, separators=(",", ":")).encode()
    return b"%08x %s\n" % (zlib.crc32(text), text)


def _content(line: bytes) -> object:
    """Return the content of a line; None for a damaged line."""
    checksum, _, text = line.partition(b" ")
    return json.loads(text) if checksum == b"%08x" % zlib.crc32(text) else None
