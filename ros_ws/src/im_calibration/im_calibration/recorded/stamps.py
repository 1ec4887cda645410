"""Stamps of messages, and moments common to several cameras."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Stamps = NDArray[np.int64]


def stamp_of(stamped: Any) -> int:
    """Return the stamp of a header, or of another message of a bag [ns]."""
    return int(stamped.stamp.sec) * 10**9 + int(stamped.stamp.nanosec)


def moments(stamps: Sequence[Stamps], tolerance_s: float) -> list[dict[int, tuple[int, int]]]:
    """Group what several cameras saw at once: stamp [ns] and number by camera, in order of time.

    Args:
        stamps: Of each camera, ascending, shape (k,) each [ns].
        tolerance_s: Largest distance of stamps of one moment [s].
    """
    every = sorted((int(stamp), camera, i) for camera, each in enumerate(stamps) for i, stamp in enumerate(each))
    groups: list[dict[int, tuple[int, int]]] = []
    begun = 0
    for stamp, camera, i in every:
        if not groups or stamp - begun > round(tolerance_s * 1e9) or camera in groups[-1]:
            groups.append({})
            begun = stamp
        groups[-1][camera] = (stamp, i)
    return groups
