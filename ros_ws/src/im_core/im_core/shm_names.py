"""Names of shared memory, outliving killed processes; without the mapping code and numpy."""

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
