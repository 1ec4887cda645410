"""Pass over ports of Fast DDS in shared memory with a killed reader and living writers.

- Upstream: a new process gets the first port without a living reader. The watch of the senders notices a dead reader
  that waited for a message or was busy with one. A reader killed between the two looks alive for ever: senders go on
  to write into the removed memory, and each next process at that port hears nothing of them.
- Mend: lock such ports while a process takes its own; Fast DDS passes over a locked port. The locks are shared: of
  processes that begin at once each passes over them. They are not held for longer: where the last writer removes a
  locked port, each new process would print an error.
- Issue: none is known.
- Seen: Fast DDS 2.14 (Jazzy), ``SharedMemGlobal.hpp``.
- Test: ``test_fast_dds_still_leaves_the_next_process_deaf`` in ``test/test_dead_ports.py`` fails once upstream has
  mended it.
"""

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
_LOCK_FILE = re.compile(r"(fastrtps_port\d+)_el")


@contextmanager
def passed_over() -> Iterator[list[str]]:
    """Hold the dead ports while a block makes the first node of a context, for which Fast DDS chooses the ports.

    Yields:
        Names of the ports.
    """
    made, locks = {}, {}
    for path in filter(is_own, SHM.glob("fastrtps_port*_el")):
        if match := _LOCK_FILE.fullmatch(path.name):
            with suppress(OSError):  # removed by the last writer, or of a living process
                made[match[1]] = (SHM / match[1]).stat().st_mtime_ns
                locks[match[1]] = lock(path, shared=True)
    with ExitStack() as held:
        written = mapped() if locks else set()
        dead = sorted(written & locks.keys(), key=made.__getitem__)[-MOST_HELD:]
        for port, descriptor in locks.items():
            if port in dead:
                held.callback(os.close, descriptor)
            else:
                os.close(descriptor)
        yield dead


def has_ports() -> bool:
    """Return whether the present process reads a port, so that it has a context with nodes."""
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # closed meanwhile
            path = descriptor.readlink()
            if path.parent == SHM and _LOCK_FILE.fullmatch(path.name):
                return True
    return False
