"""Firings of the nets, and the nets that there are."""

import contextlib
import queue
import time
from collections.abc import Iterator

from rclpy.qos import DurabilityPolicy, QoSProfile

from im.commands import DISPATCHER
from im.connection import PATIENCE_S, Connection
from im.errors import MachineError
from im.heartbeats import Heartbeats
from im.messages import number_of
from im.waits import next_of
from im_msgs.msg import Firing, NetDescription

#: Firings that an iteration keeps for a slow reader.
_MOST_FIRINGS = 10_000
#: Descriptions of nets that are kept while the connection is busy.
_MOST_NETS = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: Once no net was told for so long [s], all are known.
_SETTLED_S = 3.0


class KnownNets:
    """Names of the nets on ``/pnt/nets``; subscribed to when a name is first asked for."""

    def __init__(self, connection: Connection) -> None:
        self._connection, self._names, self._told = connection, set[str](), -1.0

    def require(self, name: str) -> None:
        """Wait until a net is told.

        Raises:
            MachineError: There is no such net.
            UnreachableError: No net was told.
        """
        if self._told < 0.0:
            self._told = time.monotonic()
            self._connection.subscribe(NetDescription, "/pnt/nets", self._hear, _MOST_NETS)
        asked = time.monotonic()

        def known() -> bool:
            settled = time.monotonic() - max(asked, self._told) > _SETTLED_S
            return name in self._names or (bool(self._names) and settled)

        self._connection.until(known, "the nets on /pnt/nets", PATIENCE_S, f"/{DISPATCHER}")
        if name not in self._names:
            there = ", ".join(sorted(self._names))
            raise MachineError(f"there is no net '{name}'; there are {there}", "not_found", {"net": name})

    def _hear(self, message: NetDescription) -> None:
        self._told = time.monotonic()
        (self._names.add if message.json else self._names.discard)(message.net)


class Firings:
    """Firings of nets, ``im_msgs/msg/Firing``: iterate for the next ones.

    Args:
        net: Name of a net; empty: all nets.
        heartbeats: Heartbeats of the tasks.
    """

    def __init__(self, net: str, heartbeats: Heartbeats) -> None:
        self._net, self._heartbeats = net, heartbeats
        self._queue: queue.Queue[Firing] = queue.Queue(_MOST_FIRINGS)

    def take(self, message: Firing) -> None:
        """Keep a firing; of a slow reader's, the oldest go."""
        if self._net in ("", message.net):
            if self._queue.full():
                with contextlib.suppress(queue.Empty):
                    self._queue.get_nowait()
            self._queue.put_nowait(message)

    def __iter__(self) -> Iterator[Firing]:
        """Iterate as long as the machine runs.

        Raises:
            UnreachableError: The machine has ended.
        """
        while True:
            yield next_of(self._queue, lambda: self._heartbeats.require(DISPATCHER))

    def next(self, timeout: float) -> Firing | None:
        """Return the next firing, None if there is none in time [s]."""
        with contextlib.suppress(queue.Empty):
            return self._queue.get(timeout=max(0.0, number_of("timeout", timeout)))
        return None
