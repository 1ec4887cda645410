"""The files of a journal: a folder held by one process, with append-only files."""

import contextlib
import os
from pathlib import Path
from typing import Protocol

from im_core.errors import StateError, StoreError
from im_core.file_lock import FileLock
from im_core.files import make_folder, synchronise_names
from im_pnt.errors import JournalError

LOCK = "lock"


class Growing(Protocol):
    """File open for appending."""

    def write(self, data: bytes) -> None:
        """Hand bytes to the operating system, where the bytes outlive the process.

        Raises:
            OSError: They were not all taken; the file is as long as before.
        """

    def sync(self) -> None:
        """Wait until all written bytes are on the disk."""

    def close(self) -> None:
        """Close the file."""


class Files(Protocol):
    """File system of a journal."""

    name: str

    def lock(self) -> None:
        """Take the folder for the own process.

        Raises:
            JournalError: Another process has it; names its id.
        """

    def unlock(self) -> None:
        """Give the folder back."""

    def names(self) -> list[str]:
        """Return the names of the files, sorted."""

    def read(self, name: str) -> bytes:
        """Return the content of a file."""

    def create(self, name: str) -> Growing:
        """Make an empty file, in the place of one of the name."""

    def extend(self, name: str, size: int) -> Growing:
        """Open a file for writing behind the first ``size`` bytes; drop the rest."""

    def rename(self, name: str, new: str) -> None:
        """Rename a file, atomically and durably."""

    def remove(self, name: str) -> None:
        """Remove a file."""

    def move_aside(self, names: list[str], folder: str) -> None:
        """Move files into a new subfolder."""


class _File:
    """A file of a :class:`Folder`."""

    def __init__(self, path: Path, size: int, flags: int) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | flags, 0o600)  # it holds the secret of a link
        self._size = size
        os.ftruncate(self._file, size)
        os.lseek(self._file, size, os.SEEK_SET)

    def write(self, data: bytes) -> None:
        try:
            written = os.write(self._file, data)
            while written < len(data):
                written += os.write(self._file, memoryview(data)[written:])
        except OSError:
            os.ftruncate(self._file, self._size)
            os.lseek(self._file, self._size, os.SEEK_SET)
            raise
        self._size += len(data)

    def sync(self) -> None:
        os.fdatasync(self._file)

    def close(self) -> None:
        with contextlib.suppress(OSError):  # it is closed all the same, and what was promised is written
            os.close(self._file)


class Folder:
    """Files of a real folder, made where missing.

    Raises:
        JournalError: It cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.name = str(path)
        self._lock: FileLock | None = None
        try:
            make_folder(path)
        except StoreError as error:
            raise JournalError(f"no journal can be kept: {error.message}", file=self.name) from error

    def lock(self) -> None:
        """Take the folder for the own process, until the end.

        Raises:
            JournalError: Another process has it; names its id.
        """
        try:
            self._lock = FileLock(self.path / LOCK)
        except StateError as error:
            holder = error.facts["pid"]
            text = f"{self.name}: the journal is in use by process {holder}; a journal belongs to one process"
            raise JournalError(text, file=self.name, pid=holder) from error
        except StoreError as error:
            text = f"{self.name}: the journal cannot be locked: {error.facts['reason']}"
            raise JournalError(text, file=self.name) from error

    def unlock(self) -> None:
        """Give the folder back."""
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def names(self) -> list[str]:
        """Return the names of the files, sorted."""
        return sorted(entry.name for entry in self.path.iterdir() if entry.is_file() and entry.name != LOCK)

    def read(self, name: str) -> bytes:
        """Return the content of a file."""
        return (self.path / name).read_bytes()

    def create(self, name: str) -> Growing:
        """Make an empty file, in the place of one of the name."""
        return _File(self.path / name, 0, os.O_TRUNC)

    def extend(self, name: str, size: int) -> Growing:
        """Open a file for writing behind the first ``size`` bytes; drop the rest."""
        return _File(self.path / name, size, 0)

    def rename(self, name: str, new: str) -> None:
        """Rename a file, atomically and durably."""
        (self.path / name).rename(self.path / new)
        synchronise_names(self.path)

    def remove(self, name: str) -> None:
        """Remove a file."""
        (self.path / name).unlink(missing_ok=True)

    def move_aside(self, names: list[str], folder: str) -> None:
        """Move files into a new subfolder."""
        (self.path / folder).mkdir(parents=True)
        for name in names:
            (self.path / name).rename(self.path / folder / name)
        for each in (self.path / folder, self.path):
            synchronise_names(each)
