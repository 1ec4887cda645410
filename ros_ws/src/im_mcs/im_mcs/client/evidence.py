"""Evidence of an abort as files: arrays for programs, a table for people."""

import io
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from im_core import clock
from im_core.errors import ImError
from im_core.files import write_whole
from im_mcs.protocol.evidence import PER_JOINT

AT_ONCE, EACH_S = 10, 2.0
"""Files of one kind of fault: so many at once, and then one in so many seconds."""

_AXES = ("fx", "fy", "fz", "tx", "ty", "tz")


class EvidenceLimit:
    """Limit of files for each kind of fault: a client whose goals fail thirty times a second would fill the disk."""

    def __init__(self) -> None:
        self._due_s: dict[str, float] = {}

    def allows(self, code: str, now_s: float) -> bool:
        """Return whether another file may be written at a monotonic time, and count the file."""
        due_s = max(self._due_s.get(code, -math.inf), now_s - (AT_ONCE - 1) * EACH_S)
        if due_s > now_s:
            return False
        self._due_s[code] = due_s + EACH_S
        return True


def write_evidence(folder: Path, record: Mapping[str, Any], fault: ImError, joints: tuple[str, ...] = ()) -> Path:
    """Write ``<date>-<time>_<tick>_<code>.npz`` and ``.csv`` into ``folder``; each appears whole or not at all.

    The ticks of a servo that was started again begin at 0: without the time a file would replace an older one.

    Args:
        folder: Where to; made if it is not there.
        record: As :meth:`im_mcs.protocol.evidence.Records.read` gives it.
        fault: Why; code, message and facts are in the ``.npz`` as JSON, under ``fault``.
        joints: Names of the joints, for the table; numbers if not given.

    Returns:
        The ``.npz`` file.

    Raises:
        ImError: The folder cannot be written to (code ``file``).
    """
    ticks = record["tick"]
    stem = f"{clock.stamp_name()}_{int(ticks[-1]) if len(ticks) else 0:09d}_{fault.code}"
    told = json.dumps({"code": fault.code, "message": fault.message, "facts": fault.facts}, default=str)
    arrays = io.BytesIO()
    np.savez_compressed(arrays, fault=np.array(told), joints=np.array(joints), **dict(record))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / f"{stem}.csv", _table(record, joints, fault))
        return write_whole(folder / f"{stem}.npz", arrays.getvalue())
    except OSError as error:
        raise ImError(f"evidence cannot be written to {folder}: {error}", code="file", file=str(folder)) from error


def _table(record: Mapping[str, Any], joints: tuple[str, ...], fault: ImError) -> str:
    names = joints or tuple(str(k) for k in range(record["q"].shape[1]))
    wrenches = [f"wrench_{k}_{axis}" for k in range(record["wrench"].shape[1]) for axis in _AXES]
    head = ["tick", "stamp_ns", *(f"{name}.{column}" for column in PER_JOINT for name in names), *wrenches]
    lines = [f"# {fault.message}".replace("\n", " "), ",".join(head)]
    rows = len(record["tick"])
    values = np.hstack([*(record[column] for column in PER_JOINT), record["wrench"].reshape(rows, -1)])
    for tick, stamp, row in zip(record["tick"], record["stamp_ns"], values.tolist(), strict=True):
        lines.append(f"{tick},{stamp}," + ",".join(f"{value:.9g}" for value in row))
    return "\n".join(lines) + "\n"
