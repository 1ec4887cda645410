"""Text of net files, whatever the path leads to."""

import os
import stat
from pathlib import Path

from im_pnt.errors import NetFileError

MAX_YAML = 4 * 2**20
"""Largest YAML file [bytes]."""


def read_text(path: Path) -> str:
    """Reads a YAML file.

    Raises:
        NetFileError: No such file, not a file, too large, or not UTF-8.
    """
    data = read_bytes(path, MAX_YAML)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        column = error.start - data.rfind(b"\n", 0, error.start)
        raise NetFileError(str(path), line, f"is not UTF-8 text: {error.reason}", column) from error


def read_bytes(path: Path, limit: int) -> bytes:
    """Reads a file.

    Args:
        path: The file.
        limit: Largest size [bytes].

    Raises:
        NetFileError: No such file, not a file, or too large.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as file:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise NetFileError(str(path), 1, "cannot be read: it is not a regular file")
            data = file.read(limit + 1)
    except OSError as error:
        raise NetFileError(str(path), 1, f"cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise NetFileError(repr(str(path)), 1, f"cannot be read: {error}") from error
    if len(data) > limit:
        raise NetFileError(str(path), 1, f"is larger than {limit / 2**20:g} MiB; a net may not be")
    return data
