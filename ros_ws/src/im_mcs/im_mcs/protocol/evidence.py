"""The last seconds of every joint, kept in a ring and copied aside on an abort."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

KEPT = 4
"""Records that are kept; the next one replaces the oldest."""

PER_JOINT = ("q", "v", "tau", "setpoint_q", "setpoint_v", "setpoint_a", "following_error")
_HEAD = 2
_WRENCH = 6


@dataclass(frozen=True)
class RecordLayout:
    """Where the columns of a record are; a row is a tick.

    Attributes:
        rows: Ticks that are kept.
        n_joints: Joints.
        n_wrenches: Wrist force-torque sensors.
    """

    rows: int
    n_joints: int
    n_wrenches: int

    @property
    def columns(self) -> int:
        """Numbers in a row: tick, stamp, the joints' columns, the wrenches."""
        return _HEAD + len(PER_JOINT) * self.n_joints + _WRENCH * self.n_wrenches

    @property
    def ring_doubles(self) -> int:
        """Size of a ring of rows."""
        return self.rows * self.columns

    @property
    def doubles(self) -> int:
        """Size of the memory: four numbers of administration for each kept record, then the records."""
        return KEPT * (4 + self.ring_doubles)

    def arrays(self, rows: NDArray[np.float64]) -> dict[str, NDArray[np.float64] | NDArray[np.int64]]:
        """The rows of a record by name: ``tick`` (m,), ``stamp_ns`` (m,), joints (m, n), ``wrench`` (m, w, 6)."""
        n = self.n_joints
        found: dict[str, NDArray[np.float64] | NDArray[np.int64]] = {
            "tick": rows[:, 0].astype(np.int64),
            "stamp_ns": rows[:, 1].astype(np.int64),
        }
        for k, name in enumerate(PER_JOINT):
            found[name] = rows[:, _HEAD + k * n : _HEAD + (k + 1) * n].copy()
        found["wrench"] = rows[:, _HEAD + len(PER_JOINT) * n :].reshape(len(rows), self.n_wrenches, _WRENCH).copy()
        return found


class Recorder:
    """Writes a row in every tick, and keeps copies of the ring.

    Args:
        layout: Columns and rows.
        memory: Where the copies are kept, shape (layout.doubles,); shared with :class:`Records`.
    """

    def __init__(self, layout: RecordLayout, memory: NDArray[np.float64]) -> None:
        self._layout = layout
        self._ring = np.zeros((layout.rows, layout.columns))
        self._administration, self._copies = _views(layout, memory)
        self._administration[:, 0] = 0.0
        n = layout.n_joints
        self._joints = self._ring[:, _HEAD : _HEAD + len(PER_JOINT) * n].reshape(layout.rows, len(PER_JOINT), n)
        self._wrenches = self._ring[:, _HEAD + len(PER_JOINT) * n :]
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
        row = self._count % self._layout.rows
        head, block = self._ring[row], self._joints[row]
        head[0], head[1] = tick, stamp_ns
        block[0], block[1], block[2] = joints
        block[3:6] = setpoint
        np.subtract(setpoint[0], joints[0], out=block[6])
        self._wrenches[row] = wrench.ravel()
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
        administration = self._administration[kept]
        administration[0] = 0.0  # whoever reads now sees that the record is being replaced
        self._copies[kept] = self._ring
        administration[1], administration[2] = self._count, min(self._count, self._layout.rows)
        administration[0] = self.newest


class Records:
    """Reader of the records of :class:`Recorder`.

    Args:
        layout: Columns and rows.
        memory: Shape (layout.doubles,).
    """

    def __init__(self, layout: RecordLayout, memory: NDArray[np.float64]) -> None:
        self._layout = layout
        self._administration, self._copies = _views(layout, memory)

    def read(self, number: int) -> dict[str, NDArray[np.float64] | NDArray[np.int64]] | None:
        """Return a record by name of the columns, oldest tick first; None if replaced by later ones, or never made."""
        kept = number % KEPT
        if number < 1 or int(self._administration[kept, 0]) != number:
            return None
        count, rows = int(self._administration[kept, 1]), int(self._administration[kept, 2])
        order = np.arange(count - rows, count) % self._layout.rows
        copy = self._copies[kept][order]
        if int(self._administration[kept, 0]) != number:
            return None
        return self._layout.arrays(copy)


def _views(layout: RecordLayout, memory: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    administration = memory[: 4 * KEPT].reshape(KEPT, 4)
    return administration, memory[4 * KEPT : layout.doubles].reshape(KEPT, layout.rows, layout.columns)
