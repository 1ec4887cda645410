"""The names of shared memory, which outlive processes that were killed; without what maps it, which needs numpy."""

from contextlib import suppress
from pathlib import Path

from im_core.ownership import is_own

SHM = Path("/dev/shm")


def remove_all(prefix: str) -> list[str]:
    """Remove every block and semaphore whose name begins with ``prefix``, as after ``kill -9`` of their owners.

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
    """Files of ``/dev/shm`` that :func:`remove_all` would remove; among them those that were being written."""
    return sorted(path for path in SHM.iterdir() if path.name.startswith((prefix, f"sem.{prefix}", f".{prefix}")))
