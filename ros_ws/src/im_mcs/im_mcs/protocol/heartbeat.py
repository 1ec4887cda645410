"""Heartbeats of two processes to each other."""

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core import clock
from im_core.patience import Silence

OWNER, SERVO = 0, 1

_LOOK_S = 0.02


class ServoHeartbeat:
    """Counter for each side; a standing counter shows the time of silence.

    Args:
        memory: Fields of :data:`LAYOUT`, shape (), all zeros at first.
        mine: Index of the counter that this side moves.
    """

    LAYOUT = np.dtype([("counters", "<u8", (2,)), ("pids", "<u8", (2,))], align=True)

    def __init__(self, memory: NDArray[Any], mine: int) -> None:
        self._counters, self._pids = memory["counters"], memory["pids"]
        self._mine, self._other = mine, 1 - mine
        self._pids[mine] = os.getpid()
        self._seen = int(self._counters[self._other])
        self._silence: Silence | None = None
        self._since = self._next_look = clock.monotonic()

    def beat(self) -> None:
        """Give a heartbeat."""
        self._counters[self._mine] += 1

    def silence_s(self) -> float:
        """Return the time without a sign of the other side, as counted by :class:`Silence` [s].

        It is 0 before the first; a side that does not listen for a while is not deceived about the other.
        """
        now, seen = clock.monotonic(), int(self._counters[self._other])
        if seen != self._seen or seen == 0:
            self._seen, self._silence, self._since = seen, None, now
            return 0.0
        if self._silence is None:
            self._silence = Silence(int(self._pids[self._other]), now - self._since)
        elif now >= self._next_look:
            self._silence.look()
        else:
            return self._silence.seconds
        self._next_look = now + _LOOK_S
        return self._silence.seconds
