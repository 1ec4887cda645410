"""Samples of the joints from the servo to the owner: a ring of records, the newest stay."""

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from im_core.shm import SharedBlock

_KEPT = 128
_HEADER = 64


def sample_type(n_joints: int, n_grippers: int, n_wrenches: int) -> np.dtype[np.void]:
    """Return the fields of a sample; arrays over all joints in the order."""
    joints = (n_joints,)
    return np.dtype(
        [
            ("stamp_ns", "<i8"),
            ("tick", "<i8"),
            ("q", "<f8", joints),
            ("v", "<f8", joints),
            ("tau", "<f8", joints),
            ("age", "<f8", joints),
            ("setpoint_q", "<f8", joints),
            ("setpoint_v", "<f8", joints),
            ("setpoint_a", "<f8", joints),
            ("brakes", "?", joints),
            ("gripper", "<f8", (n_grippers,)),
            ("gripper_force", "<f8", (n_grippers,)),
            ("wrench", "<f8", (n_wrenches, 6)),
        ],
        align=True,
    )


class SampleRing:
    """Ring with one writer without waits, and one reader of all records since the last look.

    A reader that is too slow loses the oldest. A sample that the writer may be writing over is not handed out.
    """

    def __init__(self, block: SharedBlock, dtype: np.dtype[np.void]) -> None:
        """Use :meth:`create` or :meth:`attach`."""
        self._block = block
        self._head = block.array("<u8", 1)
        self._records = block.array(dtype, _KEPT, offset=_HEADER)
        self._taken = 0
        self.fields = dtype.names or ()

    @classmethod
    def create(cls, name: str, dtype: np.dtype[np.void]) -> Self:
        """Create the ring, as the reader."""
        block = SharedBlock.create(name, _HEADER + _KEPT * dtype.itemsize)
        block.publish()
        return cls(block, dtype)

    @classmethod
    def attach(cls, name: str, dtype: np.dtype[np.void], timeout_s: float) -> Self:
        """Attach, as the writer.

        Raises:
            LinkError: It did not appear within ``timeout_s`` [s].
        """
        return cls(SharedBlock.attach(name, timeout_s), dtype)

    def next_record(self) -> NDArray[np.void]:
        """Return the record to fill next, shape (); :meth:`push_record` makes the record readable."""
        return self._records[int(self._head[0]) % _KEPT : int(self._head[0]) % _KEPT + 1].reshape(())

    def push_record(self) -> None:
        """The record of :meth:`next_record` is complete."""
        self._head[0] += np.uint64(1)

    def take_samples(self) -> list[dict[str, Any]]:
        """Return samples since the last call, oldest first, each by the fields; arrays as lists."""
        head = int(self._head[0])
        first = max(self._taken, head - _KEPT + 1)
        copies = [self._records[k % _KEPT].copy() for k in range(first, head)]
        lost = int(self._head[0]) - _KEPT + 1 - first  # those that were written over while they were copied
        self._taken = head
        return [{name: copy[name].tolist() for name in self.fields} for copy in copies[max(lost, 0) :]]

    def close(self) -> None:
        """Release the memory; the creator removes the name."""
        self._block.close()
