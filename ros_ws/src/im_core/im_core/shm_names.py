"""Names of shared memory, outliving killed processes; without the mapping code and numpy."""

import fcntl
import os
import re
from contextlib import suppress
from pathlib import Path

from im_core.ownership import is_own

SHM = Path("/dev/shm")


def remove_all(prefix: str) -> list[str]:
    """Remove every block and semaphore with names beginning with ``prefix``, as after ``kill -9`` of the owners.

    Names begin with the machine's instance and an underscore: ``remove_all("im7_")`` clears all of ``im7``. What
    belongs to another user, or cannot be removed, stays (:func:`left`).

    Returns:
        Names of the files removed from ``/dev/shm``.
    """
    removed = []
    for path in filter(is_own, left(prefix)):
        with suppress(OSError):
            path.unlink()
            removed.append(path.name)
    return removed


def left(prefix: str) -> list[Path]:
    """Return the ``/dev/shm`` files still to be removed by :func:`remove_all`, files being written included."""
    return sorted(path for path in SHM.iterdir() if path.name.startswith((prefix, f"sem.{prefix}", f".{prefix}")))


def lock(path: Path, shared: bool = False) -> int:
    """Lock a file for the present process; return the descriptor. No link is followed, no FIFO waited for.

    Args:
        path: The file.
        shared: Whether other processes may hold a shared lock beside.

    Raises:
        FileNotFoundError: There is none.
        OSError: A process holds the lock, or the file cannot be opened.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def mapped() -> set[str]:
    """Return the names of files of ``/dev/shm`` in the memory of processes, also of removed files."""
    found: set[str] = set()
    for maps in Path("/proc").glob("[0-9]*/maps"):
        with suppress(OSError):  # of another user, or gone meanwhile
            found.update(re.findall(r"/dev/shm/(\S+)", maps.read_text(encoding="utf-8", errors="replace")))
    return found
