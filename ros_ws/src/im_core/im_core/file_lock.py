"""Locks of files, each held by one process."""

import fcntl
import os
from contextlib import suppress
from pathlib import Path

from im_core.errors import StateError, StoreError


class FileLock:
    """Lock on a file, held until :meth:`release` or the end of the process; the file names the process.

    Args:
        path: The file, made if missing, for the user alone: any user able to read it could hold it.

    Raises:
        StateError: Another process holds it, in the facts as ``pid``.
        StoreError: It cannot be locked.
    """

    def __init__(self, path: Path) -> None:
        self._file: int | None = None
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        except OSError as error:
            raise StoreError.of("locked", path, error) from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            told = b""
            with suppress(OSError):
                told = os.read(self._file, 32)
            self.release()
            holder = told.decode("ascii", "replace").strip() or "unknown"
            raise StateError(f"{path} is held by process {holder}", file=str(path), pid=holder) from error
        except OSError as error:
            self.release()
            raise StoreError.of("locked", path, error) from error
        with suppress(OSError):  # a disk that is full: the lock holds, though it does not say whose it is
            os.ftruncate(self._file, 0)
            os.write(self._file, b"%d\n" % os.getpid())

    def release(self) -> None:
        """Give the lock back."""
        if self._file is not None:
            with suppress(OSError):
                os.close(self._file)
            self._file = None

    def __del__(self) -> None:
        self.release()
