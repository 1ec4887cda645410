"""Files that are written whole or not at all."""

import contextlib
import os
import threading
from pathlib import Path

from im_core.errors import StoreError


def write_whole(path: Path, content: str | bytes) -> Path:
    """Write a file in one step: whoever reads it, even after a loss of power, sees the old one or the new one.

    Args:
        path: The file; where it is a symbolic link, what it points to is replaced.
        content: Text, written as UTF-8, or bytes.

    Returns:
        `path`.

    Raises:
        StoreError: It cannot be written; what was there before is untouched.
    """
    target = path.resolve() if path.is_symlink() and path.exists() else path
    beside = target.with_name(f".{target.name[:100]}.{os.getpid()}.{threading.get_native_id()}")
    data = content.encode() if isinstance(content, str) else content
    try:
        with beside.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, target)
    except BaseException as error:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise StoreError.of("written", path, error) from error
        raise
    return path


def make_folder(path: Path) -> Path:
    """Make a folder, and those it is in, where they are missing.

    Returns:
        `path`.

    Raises:
        StoreError: It cannot be made, or is something else.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError.of("made", path, error) from error
    return path
