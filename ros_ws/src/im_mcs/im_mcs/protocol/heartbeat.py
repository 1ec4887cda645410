"""Signs of life of two processes to each other."""

from typing import Self

from im_core import clock
from im_core.shm import SharedBlock

OWNER, SERVO = 0, 1


class ServoHeartbeat:
    """A counter for each side; who sees the other's stand still knows for how long.

    Args:
        block: Two counters.
        mine: Which one this side moves.
    """

    def __init__(self, block: SharedBlock, mine: int) -> None:
        """Use :meth:`create` or :meth:`attach`."""
        self._block = block
        self._counters = block.array("<u8", 2)
        self._mine, self._other = mine, 1 - mine
        self._seen = int(self._counters[self._other])
        self._since = clock.monotonic()

    @classmethod
    def create(cls, name: str) -> Self:
        """Create the counters, as the owner."""
        block = SharedBlock.create(name, 64)
        block.publish()
        return cls(block, OWNER)

    @classmethod
    def attach(cls, name: str, timeout_s: float) -> Self:
        """Attach, as the servo.

        Raises:
            LinkError: It did not appear within ``timeout_s`` [s].
        """
        return cls(SharedBlock.attach(name, timeout_s), SERVO)

    def beat(self) -> None:
        """Give a sign of life."""
        self._counters[self._mine] += 1

    def silence_s(self) -> float:
        """For how long the other side has given none that this side saw, wall time [s]; 0 before its first."""
        now, seen = clock.monotonic(), int(self._counters[self._other])
        if seen != self._seen or seen == 0:
            self._seen, self._since = seen, now
        return now - self._since

    def close(self) -> None:
        """Release the memory; the creator removes the name."""
        self._block.close()
