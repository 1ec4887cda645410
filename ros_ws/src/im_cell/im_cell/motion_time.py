"""Time of straight motions of joints from rest to rest, as fast as limits allow.

Seven phases of constant jerk, fewer where the way is too short. Source: L. Biagiotti, C. Melchiorri, "Trajectory
Planning for Automatic Machines and Robots" (2008), section 3.4.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from im_cell.robot import Cell

Array = NDArray[np.float64]


def motion_times(cell: Cell, joints: Sequence[str], ways: Array) -> Array:
    """Return the times of straight motions by the limits of a cell, shape (...) [s].

    Args:
        cell: The joints.
        joints: Names of those that move, n of them.
        ways: From where to where each goes, shape (..., n) [rad or m].
    """
    limits = [joint.limits for name in joints for joint in cell.joints if joint.name == name]
    with np.errstate(divide="ignore", over="ignore"):
        # limits of the share of the way that is covered
        v, a, j = (
            (np.array([getattr(each, kind) for each in limits]) / np.abs(ways)).min(axis=-1)
            for kind in ("velocity", "acceleration", "jerk")
        )
    still = np.isinf(v)
    v, a, j = (np.where(still, 1.0, each) for each in (v, a, j))
    ramp = np.where(v * j >= a**2, v / a + a / j, 2.0 * np.sqrt(v / j))
    slower = 0.5 * a * (np.sqrt((a / j) ** 2 + 4.0 / a) - a / j)  # highest speed where the way is too short for v
    short = np.where(slower * j >= a**2, 2.0 * (slower / a + a / j), 4.0 * np.cbrt(0.5 / j))
    return np.asarray(np.where(still, 0.0, np.where(v * ramp <= 1.0, 1.0 / v + ramp, short)))
