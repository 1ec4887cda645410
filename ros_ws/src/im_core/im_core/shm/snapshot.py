"""One record, written by one process and read by any number of others (a seqlock)."""

from typing import Self

import numpy as np
from numpy.typing import NDArray

from im_core import clock
from im_core.errors import LinkError
from im_core.shm.block import SharedBlock

_READ_TIMEOUT_S = 0.5


class Snapshot:
    """The newest value of a structured record.

    A sequence number is odd while the writer writes; a reader copies and keeps the copy if the number was even and
    did not change. Writing never waits.
    """

    def __init__(self, block: SharedBlock, dtype: np.dtype[np.void]) -> None:
        """Use :meth:`create` or :meth:`attach`."""
        self._block = block
        self._dtype = dtype
        self._sequence = block.array("<u8", 1)
        self._bytes = block.array("u1", dtype.itemsize, offset=64)
        self._torn = 0

    @classmethod
    def create(cls, name: str, dtype: np.dtype[np.void]) -> Self:
        """Create the snapshot as the only writer; the record is all zeros until the first :meth:`write`."""
        block = SharedBlock.create(name, 64 + dtype.itemsize)
        block.publish()
        return cls(block, dtype)

    @classmethod
    def attach(cls, name: str, dtype: np.dtype[np.void], timeout_s: float) -> Self:
        """Attach as a reader (or as the writer, if the creator only reads).

        Raises:
            LinkError: It did not appear within ``timeout_s`` [s], or holds a record of another size.
        """
        block = SharedBlock.attach(name, timeout_s)
        if block.size != 64 + dtype.itemsize:
            raise LinkError(
                f"snapshot '{name}' holds records of {block.size - 64} bytes, not of {dtype.itemsize}", name=name
            )
        return cls(block, dtype)

    @property
    def sequence(self) -> int:
        """Number of records written so far."""
        return int(self._sequence[0]) // 2

    def record(self) -> NDArray[np.void]:
        """An empty record of shape (), to be filled and written."""
        return np.zeros((), dtype=self._dtype)

    def write(self, record: NDArray[np.void]) -> None:
        """Make ``record``, shape (), the newest value."""
        data = np.frombuffer(record.tobytes(), dtype="u1")
        odd = int(self._sequence[0]) | 1  # a writer that died inside a write left it odd
        self._sequence[0] = odd
        self._bytes[:] = data
        self._sequence[0] = odd + 1

    def read(self) -> NDArray[np.void]:
        """Return a copy of the newest record, shape ().

        A write that was once waited for in vain is not waited for again.

        Raises:
            LinkError: The writer died, or stands still, in the middle of a write.
        """
        deadline = 0.0
        while True:
            before = int(self._sequence[0])
            data = self._bytes.tobytes()
            if before % 2 == 0 and int(self._sequence[0]) == before:
                return np.frombuffer(data, dtype=self._dtype).reshape(())
            if deadline == 0.0:
                deadline = clock.monotonic() + _READ_TIMEOUT_S
            elif before == self._torn or clock.monotonic() > deadline:
                self._torn = before
                name = self._block.name
                raise LinkError(f"the writer of snapshot '{name}' stopped in the middle of a write", name=name)

    def owner_alive(self) -> bool:
        """Return whether the process of the snapshot's creator still runs."""
        return self._block.owner_alive()

    def close(self) -> None:
        """Release the memory; the creator removes the name."""
        self._block.close()
