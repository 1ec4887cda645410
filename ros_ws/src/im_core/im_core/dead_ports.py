"""Pass over ports of Fast DDS in shared memory with a killed reader and living writers.

- Upstream: a new process gets the first port without a living reader. The watch of the senders notices a dead reader
  that waited for a message or was busy with one. A reader killed between the two looks alive for ever: senders go on
  to write into the removed memory, and each next process at that port hears nothing of them.
  So it is where the port was removed meanwhile: a process that took it, and has ended, does that.
- Mend: lock such ports while a process takes its own; Fast DDS passes over a locked port. The locks are shared: of
  processes that begin at once each passes over them. They are not held for longer: where the last writer removes a
  locked port, each new process would print an error.
- Issue: none is known.
- Seen: Fast DDS 2.14 (Jazzy), ``SharedMemGlobal.hpp``.
- Test: ``test_fast_dds_still_leaves_the_next_process_deaf`` in ``test/test_dead_ports.py`` fails once upstream has
  mended it.
"""

import math
import os
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from im_core.ownership import is_own
from im_core.shm_names import SHM, lock, mapped

#: Ports passed over at most, the last made first: Fast DDS tries 100, and living processes need some.
MOST_HELD = 48
#: The lock file of a port with one reader.
_LOCK_FILE = re.compile(r"fastrtps_port\d+_el")
_PORT = re.compile(r"fastrtps_port\d+")


@contextmanager
def passed_over() -> Iterator[list[str]]:
    """Hold the dead ports while a block makes the first node of a context, for which Fast DDS chooses the ports.

    Yields:
        Names of the ports.
    """
    with ExitStack() as held:
        dead: list[str] = []
        for port in sorted(filter(_PORT.fullmatch, mapped()), key=_made_ns, reverse=True):
            with suppress(OSError):  # of a living process
                if len(dead) < MOST_HELD and not (SHM / f"{port}_sl").exists():  # that one has many readers
                    held.callback(os.close, _locked(SHM / f"{port}_el"))
                    dead.append(port)
        yield sorted(dead)


def _made_ns(port: str) -> float:
    """Return when a port was made [ns]; of a removed one, that is still in the memory of a process, infinity."""
    try:
        return (SHM / port).stat().st_mtime_ns
    except OSError:
        return math.inf


def _locked(path: Path) -> int:
    """Lock the lock file of a port, which may have to be made; return the descriptor.

    Raises:
        OSError: A living process holds the lock, or the file belongs to another user or cannot be made.
    """
    with suppress(FileExistsError):
        os.close(os.open(path, os.O_RDONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666))
    if not is_own(path):
        raise PermissionError(f"{path} belongs to another user")
    return lock(path, shared=True)


def has_ports() -> bool:
    """Return whether the present process reads a port, so that it has a context with nodes."""
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # closed meanwhile
            path = descriptor.readlink()
            if path.parent == SHM and _LOCK_FILE.fullmatch(path.name):
                return True
    return False
