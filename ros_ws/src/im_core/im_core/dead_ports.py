"""Pass over ports of Fast DDS in shared memory with a killed reader and living writers.

- Upstream: a new process gets the first port without a living reader. The watch of the senders notices a dead reader
  that waited for a message or was busy with one. A reader killed between the two looks alive for ever: senders go on
  to write into the removed memory, and each next process at that port hears nothing of them.
- Mend: lock such ports while a process takes its own; Fast DDS passes over a locked port.
- Issue: none is known.
- Seen: Fast DDS 2.14 (Jazzy), ``SharedMemGlobal.hpp``.
- Test: ``test_fast_dds_still_leaves_the_next_process_deaf`` in ``test/test_dead_ports.py`` fails once upstream has
  mended it.
"""

import os
import re
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from im_core.ownership import is_own
from im_core.shm_names import SHM, lock, mapped

#: Ports held at most: Fast DDS tries 100, and living processes need some.
MOST_HELD = 24
#: The lock file of a port with one reader.
_LOCK_FILE = re.compile(r"(fastrtps_port\d+)_el")


class DeadPorts:
    """Keeps the locks of ports of dead readers."""

    def __init__(self) -> None:
        self._held: deque[int] = deque()

    def hold(self) -> list[str]:
        """Lock each port without a living reader in the memory of a process; return the names of the new ones."""
        free, found = [], []
        for path in filter(is_own, sorted(SHM.glob("fastrtps_port*_el"))):
            if match := _LOCK_FILE.fullmatch(path.name):
                with suppress(OSError):  # of a living process, held already, or gone meanwhile
                    free.append((match[1], lock(path)))
        written = mapped() if free else set()
        for port, descriptor in free:
            if port in written:
                self._held.append(descriptor)
                found.append(port)
            else:
                os.close(descriptor)
        while len(self._held) > MOST_HELD:
            os.close(self._held.popleft())
        return found

    def close(self) -> None:
        """Release all ports."""
        while self._held:
            os.close(self._held.popleft())


@contextmanager
def passed_over() -> Iterator[None]:
    """Hold the dead ports while a block makes a node: with the first node of a process, Fast DDS chooses its ports."""
    ports = DeadPorts()
    ports.hold()
    try:
        yield
    finally:
        ports.close()
