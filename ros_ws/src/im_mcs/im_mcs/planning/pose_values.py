"""Poses as seven numbers: position [m] and unit quaternion x, y, z, w."""

import math

from im_core.errors import DataError
from im_mcs.planning.values import as_numbers

_OFF_UNIT = 0.01


def check_pose(value: object) -> list[float]:
    """A pose whose quaternion has length 1, exactly.

    Args:
        value: Seven numbers; the quaternion's length may be off by 1 %.

    Raises:
        DataError: It is not.
    """
    numbers = as_numbers(value, "the pose")
    if len(numbers) != 7:
        raise DataError(f"the pose has {len(numbers)} values, not 7 (x, y, z, qx, qy, qz, qw)")
    if not all(math.isfinite(number) for number in numbers):
        raise DataError(f"the pose {numbers} has a value that is not a finite number")
    position, orientation = numbers[:3], numbers[3:]
    length = math.hypot(*orientation)
    if abs(length - 1.0) > _OFF_UNIT:
        given = ", ".join(f"{number:.6g}" for number in orientation)
        raise DataError(f"the orientation ({given}) is not a unit quaternion: its length is {length:.4g}")
    return position + [number / length for number in orientation]
