"""Results of the last commands of a node, in memory and in a file outliving the journal.

What has ended is written before the journal has it. A node that dies in between has the command under way when it is
back, and the command ends once more, which counts. Whoever waits for a command asks its node again when that is back,
and the machine may have ended that command, and died, and have been started anew in between: so the file stays.
"""

import contextlib
import json
import os
from io import FileIO
from pathlib import Path
from typing import NamedTuple

import pydantic

from im_core.clock import wall
from im_core.errors import DataError, StoreError
from im_core.files import make_folder, read_bytes, write_whole

MOST = 100
"""Commands that are kept, the newest ones."""

MOST_BYTES = 16 << 20
"""What they take together, in memory and in the file; the newest is kept whatever it takes."""

AGE_S = 7 * 86400.0
"""Time for which one is kept [s]."""

_SHARE, _BLOCK = 1.2, 64 << 10
"""The file is written anew when it is so much longer than what is kept, and longer than this [bytes]."""


class EndedCommand(pydantic.BaseModel):
    """How a command has ended.

    Attributes:
        number: Its number.
        symbol: Its symbol.
        time: When it ended [s since 1970].
        success: Whether it is done.
        code: Kind of its failure.
        message: The failure in a sentence.
        facts: What the failure is about, as JSON texts by name.
        results: What it returned.
    """

    number: int
    symbol: str
    time: float
    success: bool
    code: str
    message: str
    facts: dict[str, str]
    results: dict[str, object]


class _Kept(NamedTuple):
    """Ended command as the line in the file: the result of a calibration is three times as large in memory."""

    symbol: str
    time: float
    line: bytes


class EndedCommands:
    """Ended commands of all incarnations of a node."""

    def __init__(self) -> None:
        self._file: Path | None = None
        self._sync = False
        self._known: dict[int, _Kept] = {}
        self._written = 0

    def keep_in(self, file: Path, *, sync: bool) -> None:
        """Keep the commands in a file, including commands already in the file.

        Args:
            file: The file.
            sync: Whether the disk must have what is written, so that it outlives a loss of power.
        """
        self._file, self._sync = make_folder(file.parent) / file.name, sync
        with contextlib.suppress(DataError, StoreError):  # there is none
            for line in read_bytes(self._file).splitlines():
                self._read(line)
        self._write_anew()

    def __contains__(self, number: int) -> bool:
        """Return whether the end of the command of a number is known."""
        self._forget()
        return number in self._known

    def __getitem__(self, number: int) -> EndedCommand:
        """Return the end of the command of a number."""
        return EndedCommand.model_construct(**json.loads(self._known[number].line))

    def largest(self) -> int:
        """Return the largest known number, 0 if there is none."""
        return max(self._known, default=0)

    def last(self, symbol: str) -> EndedCommand | None:
        """Return the end of the last command of a symbol, if known."""
        self._forget()
        return next((self[number] for number in reversed(self._known) if self._known[number].symbol == symbol), None)

    def newest(self, most: int) -> list[int]:
        """Return the numbers of the commands that ended last, the newest last."""
        self._forget()
        return list(self._known)[-most:]

    def add(self, ended: EndedCommand) -> None:
        """Keep the end of a command; on a full disk until the death of the node."""
        line = self._keep(ended)
        self._forget()
        if self._file is None:
            return
        if self._written + len(line) > max(_SHARE * self._size(), _BLOCK):
            self._write_anew()
            return
        with contextlib.suppress(OSError, ValueError), self._file.open("ab", buffering=0) as file:
            if _append(file, line):
                self._written += len(line)
                if self._sync:
                    os.fsync(file.fileno())

    def _forget(self) -> None:
        oldest, size = wall() - AGE_S, self._size()
        for number, kept in list(self._known.items()):
            too_many = len(self._known) > MOST or (size > MOST_BYTES and len(self._known) > 1)
            if too_many or kept.time < oldest:
                del self._known[number]
                size -= len(kept.line)

    def _size(self) -> int:
        return sum(len(kept.line) for kept in self._known.values())

    def _read(self, line: bytes) -> None:
        with contextlib.suppress(pydantic.ValidationError):  # it may not be whole, or damaged by the disk
            self._keep(EndedCommand.model_validate_json(line))

    def _keep(self, ended: EndedCommand) -> bytes:
        """Keep a command as the newest; return the line."""
        try:
            text = json.dumps(ended.model_dump())  # pydantic's JSON refuses halves of characters
        except (TypeError, ValueError, RecursionError):  # results that are no JSON could be told to nobody
            text = json.dumps(ended.model_copy(update={"results": {}}).model_dump())
        line = f"{text}\n".encode()
        self._known.pop(ended.number, None)
        self._known[ended.number] = _Kept(ended.symbol, ended.time, line)
        return line

    def _write_anew(self) -> None:
        self._forget()
        if self._file is not None:
            with contextlib.suppress(StoreError, ValueError):
                write_whole(self._file, b"".join(kept.line for kept in self._known.values()))
                self._written = self._size()


def _append(file: FileIO, line: bytes) -> bool:
    """Write a line whole or not at all, and return whether written: a part of a line would spoil the next one.

    Raises:
        OSError: It cannot be written.
    """
    length = file.seek(0, os.SEEK_END)
    written = 0
    try:
        written = file.write(line)
    finally:
        if written < len(line):
            file.truncate(length)
    return written == len(line)
