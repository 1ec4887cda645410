"""The names of shared memory, which outlive processes that were killed; without what maps it, which needs numpy."""

from pathlib import Path


def remove_all(prefix: str) -> list[str]:
    """Remove every block and semaphore whose name begins with ``prefix``, as after ``kill -9`` of their owners.

    Names begin with the machine's instance and an underscore: ``remove_all("im7_")`` clears all of ``im7``.

    Returns:
        Names of the files removed from ``/dev/shm``.
    """
    removed = []
    for path in sorted(Path("/dev/shm").iterdir()):
        if path.name.startswith((prefix, f"sem.{prefix}")):
            path.unlink(missing_ok=True)
            removed.append(path.name)
    return removed
