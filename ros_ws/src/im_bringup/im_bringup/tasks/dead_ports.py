"""Ports of Fast DDS in shared memory left by killed processes: no process may take one over.

Fast DDS gives a process the first free port, also that of a dead process. The watch of its senders (2.14,
``SharedMemGlobal.hpp``) notices a dead reader that waited for a message or was busy with one. A reader killed between
two messages looks alive for ever: senders go on to write into the removed memory, and the next process at that port
never hears them. A busy computer makes such a death likely, a restart after ``kill -9`` then fails.
"""

import os
import re
from collections import deque
from contextlib import suppress

from im_core.ownership import is_own
from im_core.shm_names import SHM, lock

#: Ports held at most: a process tries 100 from its first one.
MOST_HELD = 32
#: The lock file of a port with one reader, and the ports of ROS domains (RTPS specification, 9.6.2.3).
_LOCK_FILE = re.compile(r"fastrtps_port(\d+)_el")
_FIRST, _PER_DOMAIN = 7400, 250


class DeadPorts:
    """Keeps the locks of ports of dead processes in one ROS domain: Fast DDS passes over a locked port.

    Args:
        domain: The ROS domain.
    """

    def __init__(self, domain: int) -> None:
        self._ports = range(_FIRST + _PER_DOMAIN * domain, _FIRST + _PER_DOMAIN * (domain + 1))
        self._held: deque[int] = deque()

    def hold(self) -> list[int]:
        """Lock each port without a living reader; return the numbers of the newly locked ports."""
        found = []
        for path in filter(is_own, sorted(SHM.glob("fastrtps_port*_el"))):
            match = _LOCK_FILE.fullmatch(path.name)
            if match is None or int(match[1]) not in self._ports:
                continue
            with suppress(OSError):  # of a living process, held already, or gone meanwhile
                self._held.append(lock(path))
                found.append(int(match[1]))
        while len(self._held) > MOST_HELD:
            os.close(self._held.popleft())
        return found

    def close(self) -> None:
        """Release all ports."""
        while self._held:
            os.close(self._held.popleft())
