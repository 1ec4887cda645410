"""One record, written by one process and read by any number of others (a seqlock)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core import clock
from im_core.errors import LinkError

_READ_TIMEOUT_S = 0.5


class Snapshot:
    """The newest value of a structured record.

    A sequence number is odd while the writer writes; a reader copies and keeps the copy if the number was even and
    did not change. Writing never waits.
    """

    def __init__(self, memory: NDArray[Any], name: str) -> None:
        """Use the memory of a snapshot.

        Args:
            memory: Fields of :meth:`layout`, shape (); the value is all zeros until the first :meth:`write`.
            name: Name for errors.
        """
        self.name = name
        self._dtype = memory["value"].dtype
        self._sequence = memory["sequence"]
        self._bytes = memory["value"].reshape(1).view("u1")
        self._torn = 0

    @staticmethod
    def layout(dtype: np.dtype[np.void]) -> np.dtype[np.void]:
        """Return the fields of a snapshot of records of ``dtype``."""
        return np.dtype([("sequence", "<u8"), ("value", dtype)], align=True)

    @property
    def sequence(self) -> int:
        """Number of records written so far."""
        return int(self._sequence) // 2

    def record(self) -> NDArray[np.void]:
        """An empty record of shape (), to be filled and written."""
        return np.zeros((), dtype=self._dtype)

    def write(self, record: NDArray[np.void]) -> None:
        """Make ``record``, shape (), the newest value."""
        data = np.frombuffer(record.tobytes(), dtype="u1")
        odd = int(self._sequence) | 1  # a writer that died inside a write left it odd
        self._sequence[()] = odd
        self._bytes[:] = data
        self._sequence[()] = odd + 1

    def read(self) -> NDArray[np.void]:
        """Return a copy of the newest record, shape ().

        A write that was once waited for in vain is not waited for again.

        Raises:
            LinkError: The writer died, or stands still, in the middle of a write.
        """
        deadline = 0.0
        while True:
            before = int(self._sequence)
            data = self._bytes.tobytes()
            if before % 2 == 0 and int(self._sequence) == before:
                return np.frombuffer(data, dtype=self._dtype).reshape(())
            if deadline == 0.0:
                deadline = clock.monotonic() + _READ_TIMEOUT_S
            elif before == self._torn or clock.monotonic() > deadline:
                self._torn = before
                raise LinkError(
                    f"the writer of snapshot '{self.name}' stopped in the middle of a write", name=self.name
                )
