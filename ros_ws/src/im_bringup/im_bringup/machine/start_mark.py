"""Mark of a running start: at most one per ROS domain and host; ``stop`` uses the mark to request the end.

The mark is a socket with a name that no file has, which goes with the process that holds it. Any user of the host may
take such a name; the kernel tells whose process has it.
"""

import os
import select
import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from im_core import names
from im_core.errors import StateError
from im_core.ownership import user
from im_core.patience import Patience

_CREDENTIALS = struct.Struct("3i")
_POLL_S = 0.05
#: How long a start may take to hear that it is asked to end, and to end: it stops what it has started [s].
_HEARS_S, _ENDS_S = 1.0, 20.0
#: How many processes are answered at a look, and may wait for it.
_MOST_ASKING = 64


class StartMark:
    """Mark of a running start, held by the present process."""

    def __init__(self, listening: socket.socket) -> None:
        self._listening = listening
        self._asking: list[socket.socket] = []

    def stop_asked(self) -> bool:
        """Return whether ``stop`` of the same user waits for the end of the running start."""
        with suppress(OSError):  # nobody else asks
            for _ in range(_MOST_ASKING):
                asking, _ = self._listening.accept()
                if _process(asking)[1] == os.geteuid():
                    self._asking.append(asking)  # open until this start has ended, which the other side notices
                else:
                    asking.close()
        return bool(self._asking)

    def close(self) -> None:
        """Let go of the mark."""
        for each in (self._listening, *self._asking):
            each.close()


@contextmanager
def only_one() -> Iterator[StartMark]:
    """Hold the mark of the ROS domain: of two starts at a time, each would end the machine of the other.

    Raises:
        StateError: Another process holds it; the message says whose that is.
    """
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    mark = StartMark(listening)
    try:
        try:
            listening.bind(_name())
        except OSError as error:
            raise StateError(_holder_told()) from error
        listening.listen(_MOST_ASKING)
        yield mark
    finally:
        mark.close()


def end_start() -> bool:
    """Request the end of the user's running start and wait for the end; return whether there was one."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.settimeout(_HEARS_S)
        try:
            asking.connect(_name())
        except OSError:
            return False
        pid, owner = _process(asking)
        if owner != os.geteuid():
            return False
        patience = Patience([pid])
        while not select.select([asking], [], [], _POLL_S)[0]:  # until its end is closed
            if patience.look() > _ENDS_S:
                break
    return True


def _name() -> str:
    return f"\0{names.instance()}_start"


def _holder_told() -> str:
    """Name the holder of the mark, and the way out."""
    domain, way_out = names.instance().removeprefix("im"), "set another ROS_DOMAIN_ID"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.settimeout(_HEARS_S)
        try:
            asking.connect(_name())
        except OSError:
            holder = "a process that does not answer (ss -xlp shows it)"
        else:
            pid, owner = _process(asking)
            if owner == os.geteuid():
                return f"another start of ROS domain {domain} is under way (process {pid}); wait for it, or {way_out}"
            holder = f"process {pid} of {user(owner)}, not by one of yours"
    held = f"the name @{_name()[1:]}, which a start of ROS domain {domain} takes, is held by {holder}"
    return f"{held}; have that process ended, or {way_out}"


def _process(peer: socket.socket) -> tuple[int, int]:
    """Return process and user at the other end of a socket, as known to the kernel."""
    told = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    pid, owner, _ = _CREDENTIALS.unpack(told)
    return pid, owner
