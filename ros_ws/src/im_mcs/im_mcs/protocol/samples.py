"""Samples of the joints from the servo to the owner: a ring of records, the newest stay."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_cell.link.fields import Fields

_KEPT = 128


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
            ("place_s", "<f8", joints),
            ("since_s", "<f8", joints),
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

    def __init__(self, memory: NDArray[Any]) -> None:
        """Use the memory of a ring: fields of :meth:`layout`, shape (), all zeros at first."""
        self._head, self._records = memory["head"], memory["records"]
        self._taken = 0
        self.fields = self._records.dtype.names or ()
        places = [self._records[place : place + 1].reshape(()) for place in range(_KEPT)]
        self._places = [Fields([place[name] for name in self.fields]) for place in places]

    @staticmethod
    def layout(dtype: np.dtype[np.void]) -> np.dtype[np.void]:
        """Return the fields of a ring of samples of ``dtype``."""
        return np.dtype([("head", "<u8"), ("records", dtype, (_KEPT,))], align=True)

    def push_record(self, values: tuple[Any, ...]) -> None:
        """Write a record, in the order of :func:`sample_type`."""
        head = int(self._head)
        self._places[head % _KEPT].put(values)
        self._head[()] = head + 1

    def take_samples(self) -> list[dict[str, Any]]:
        """Return samples since the last call, oldest first, each by the fields; arrays as lists."""
        head = int(self._head)
        first = max(self._taken, head - _KEPT + 1)
        copies = [self._records[k % _KEPT].copy() for k in range(first, head)]
        lost = int(self._head) - _KEPT + 1 - first  # those that were written over while they were copied
        self._taken = head
        return [{name: copy[name].tolist() for name in self.fields} for copy in copies[max(lost, 0) :]]
