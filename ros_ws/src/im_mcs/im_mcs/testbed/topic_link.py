"""Shared memory between the driver of a robot that speaks topics and the process that speaks ROS for it."""

from typing import Any, Self

import numpy as np

from im_core.shm import Semaphore, Snapshot


class TopicLink:
    """Memory ``<name>_*``: what was received one way, what shall be published the other.

    Attributes:
        received: Positions and when each was received, by joint; the bridge writes.
        command: Efforts, and which joints are driven; the driver writes.
        bell: Rung by the driver when there is a command.
    """

    def __init__(self, received: Snapshot, command: Snapshot, bell: Semaphore) -> None:
        """Use :meth:`create` or :meth:`attach`."""
        self.received = received
        self.command = command
        self.bell = bell

    @classmethod
    def create(cls, name: str, n: int) -> Self:
        """Create everything for ``n`` joints, as the driver."""
        return cls(
            Snapshot.create(f"{name}_received", received_type(n)),
            Snapshot.create(f"{name}_command", command_type(n)),
            Semaphore.create(f"{name}_bell"),
        )

    @classmethod
    def attach(cls, name: str, n: int, timeout_s: float) -> Self:
        """Attach to everything, as the bridge.

        Raises:
            LinkError: The driver has not created it within ``timeout_s`` [s].
        """
        return cls(
            Snapshot.attach(f"{name}_received", received_type(n), timeout_s),
            Snapshot.attach(f"{name}_command", command_type(n), timeout_s),
            Semaphore.attach(f"{name}_bell", timeout_s),
        )

    def close(self) -> None:
        """Release everything; the driver removes the names."""
        for part in (self.received, self.command, self.bell):
            part.close()


def received_type(n: int) -> np.dtype[Any]:
    """Positions, the wall times at which they were received (0: never) [s], and the names the last message had."""
    return np.dtype([("q", "<f8", (n,)), ("at", "<f8", (n,)), ("named", "S1024")], align=True)


def command_type(n: int) -> np.dtype[Any]:
    """Efforts, which joints are driven, and when that was written, monotonic clock [s]."""
    return np.dtype([("effort", "<f8", (n,)), ("driven", "?", (n,)), ("at", "<f8")], align=True)
