"""The last seconds of every joint, kept in a ring and copied aside on an abort."""

import numpy as np
from numpy.typing import NDArray

from im_cell.link.fields import Fields

KEPT = 4
"""Records that are kept; the next one replaces the oldest."""

PER_JOINT = ("q", "v", "tau", "setpoint_q", "setpoint_v", "setpoint_a", "following_error")


def record_type(rows: int, n_joints: int, n_wrenches: int) -> np.dtype[np.void]:
    """Return the fields of a kept record: its number, rows since the start, and the last ``rows`` rows, one a tick."""
    joints, wrenches = (len(PER_JOINT), n_joints), (n_wrenches, 6)
    row = np.dtype([("tick", "<i8"), ("stamp_ns", "<i8"), ("joints", "<f8", joints), ("wrench", "<f8", wrenches)])
    return np.dtype([("number", "<i8"), ("count", "<i8"), ("rows", row, (rows,))], align=True)


class Recorder:
    """Writes a row in every tick, and keeps copies of the ring.

    Args:
        memory: Place of the copies, of :func:`record_type`, shape (KEPT,); shared with :class:`Records`.
    """

    def __init__(self, memory: NDArray[np.void]) -> None:
        self._numbers, self._counts, self._copies = memory["number"], memory["count"], memory["rows"]
        self._numbers[:] = 0
        self._ring = np.zeros_like(self._copies[0])
        self._rows = [_fields_of(self._ring[row : row + 1].reshape(())) for row in range(len(self._ring))]
        self._count = 0
        self._wanted = False
        self.newest = 0

    def put_row(
        self,
        tick: int,
        stamp_ns: int,
        joints: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
        setpoint: NDArray[np.float64],
        wrench: NDArray[np.float64],
    ) -> None:
        """Write the row of a tick.

        Args:
            tick: Number of the tick.
            stamp_ns: Testbed time [ns].
            joints: Positions, velocities and torques, shape (n,) each.
            setpoint: Positions, velocities and accelerations, shape (3, n).
            wrench: Shape (w, 6).
        """
        row = self._rows[self._count % len(self._rows)]
        row.put((tick, stamp_ns, *joints, setpoint, setpoint[0] - joints[0], wrench))
        self._count += 1
        if self._wanted:
            self.keep()

    def freeze(self) -> int:
        """Keep the ring after the current tick's row; return the number of the record, one per tick."""
        if not self._wanted:
            self._wanted = True
            self.newest += 1
        return self.newest

    def keep(self) -> None:
        """Copy the ring now if requested by :meth:`freeze`: the current tick may have no row."""
        if not self._wanted:
            return
        self._wanted = False
        kept = self.newest % KEPT
        self._numbers[kept] = 0  # a reader sees that the record is being replaced
        self._copies[kept] = self._ring
        self._counts[kept] = self._count
        self._numbers[kept] = self.newest


def _fields_of(row: NDArray[np.void]) -> Fields:
    """Return the fields of a row, in the order in which a tick gives them."""
    joints = row["joints"]
    return Fields([row["tick"], row["stamp_ns"], *joints[:3], joints[3:6], joints[6], row["wrench"]])


class Records:
    """Reader of the records of :class:`Recorder`.

    Args:
        memory: Of :func:`record_type`, shape (KEPT,).
    """

    def __init__(self, memory: NDArray[np.void]) -> None:
        self._numbers, self._counts, self._copies = memory["number"], memory["count"], memory["rows"]

    def read(self, number: int) -> dict[str, NDArray[np.float64] | NDArray[np.int64]] | None:
        """Return a record, oldest tick first; None if replaced by later ones, or never made.

        ``tick`` and ``stamp_ns`` have shape (m,), each name of :data:`PER_JOINT` (m, n), ``wrench`` (m, w, 6).
        """
        kept = number % KEPT
        if number < 1 or int(self._numbers[kept]) != number:
            return None
        count, rows = int(self._counts[kept]), self._copies.shape[1]
        copy = self._copies[kept][np.arange(max(0, count - rows), count) % rows]
        if int(self._numbers[kept]) != number:
            return None
        joints = {name: copy["joints"][:, k] for k, name in enumerate(PER_JOINT)}
        return {"tick": copy["tick"], "stamp_ns": copy["stamp_ns"], **joints, "wrench": copy["wrench"]}
