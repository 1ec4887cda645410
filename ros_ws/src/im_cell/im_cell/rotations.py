"""Rotations of messages, files and estimates: quaternions x, y, z, w, rotation vectors, and matrices.

By numpy: nodes need them before the machine is ready, and ``scipy.spatial`` takes a third of a second to load.
"""

from math import atan2, hypot

import numpy as np
from numpy.typing import ArrayLike, NDArray

from im_core.errors import DataError

Array = NDArray[np.float64]

UNIT_TOLERANCE = 1e-3
"""How far from 1 the length of a quaternion may be."""
_ROUNDING = 1e-12
"""A length as near to 1 as this is 1: to divide by the rest would change the last digits once more."""
_UPRIGHT = 1e-9
"""Cosine of a pitch that counts as a right angle."""
_AXES = np.cross(np.eye(3), np.eye(3)[:, None]).reshape(3, 9)
"""Row by row: the matrices of the cross product with x, y and z."""


def cross_matrix(vector: ArrayLike) -> Array:
    """Return the matrix [v]x of the cross product with a vector v, shape (..., 3) -> (..., 3, 3)."""
    given = np.asarray(vector, dtype=np.float64)
    return (given @ _AXES).reshape(*given.shape, 3)


def matrix_of_quaternion(quaternion: ArrayLike, what: str = "the orientation") -> Array:
    """Return the rotation matrices of unit quaternions, shape (..., 4) -> (..., 3, 3).

    Args:
        quaternion: Of a length near 1, by which it is divided.
        what: Whose it is, for the error.

    Raises:
        DataError: A length is off 1 by more than the tolerance.
    """
    given = np.asarray(quaternion, dtype=np.float64)
    length = np.linalg.norm(given, axis=-1, keepdims=True)
    if (wrong := length[~(np.abs(length - 1.0) <= UNIT_TOLERANCE)]).size:
        raise DataError(f"{what} has length {wrong[0]:.4g}, it must be 1")
    x, y, z, w = np.moveaxis(given / np.where(np.abs(length - 1.0) < _ROUNDING, 1.0, length), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_of_matrix(rotation: Array) -> tuple[float, float, float, float]:
    """Return the unit quaternion (x, y, z, w) of a rotation, shape (3, 3), the largest element positive.

    Source: Shepperd, "Quaternion from rotation matrix" (1978).
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation.tolist()
    products = np.array(  # four times the product of each two elements
        [
            [1.0 + xx - yy - zz, xy + yx, xz + zx, zy - yz],
            [xy + yx, 1.0 - xx + yy - zz, yz + zy, xz - zx],
            [xz + zx, yz + zy, 1.0 - xx - yy + zz, yx - xy],
            [zy - yz, xz - zx, yx - xy, 1.0 + xx + yy + zz],
        ]
    )
    largest = products[products.diagonal().argmax()]
    x, y, z, w = (largest / np.linalg.norm(largest)).tolist()
    return x, y, z, w


def matrix_of_vector(vector: ArrayLike) -> Array:
    """Return the rotation matrix of a rotation vector, shape (3,) [rad] -> (3, 3), by Rodrigues' formula."""
    angle, cross = float(np.linalg.norm(vector)), cross_matrix(vector)
    # with sinc there is no division by an angle of 0: sin(a) / a, and (1 - cos(a)) / a^2 = sinc(a / 2)^2 / 2
    half = np.sinc(0.5 * angle / np.pi)
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half**2 * cross @ cross)


def matrix_of_rpy(rpy: tuple[float, ...]) -> Array:
    """Return the rotation matrix of roll, pitch and yaw [rad], about the fixed axes x, y and z, as in URDF."""
    roll, pitch, yaw = (matrix_of_vector(angle * axis) for angle, axis in zip(rpy, np.eye(3), strict=True))
    return yaw @ pitch @ roll


def rpy_of_matrix(rotation: Array) -> tuple[float, float, float]:
    """Return roll, pitch and yaw [rad] of a rotation, shape (3, 3), as in URDF; where yaw and roll are one, yaw is 0.

    Source: Slabaugh, "Computing Euler angles from a rotation matrix" (1999).
    """
    (xx, _, _), (yx, yy, yz), (zx, zy, zz) = rotation.tolist()
    pitch = atan2(-zx, hypot(xx, yx))
    if hypot(xx, yx) < _UPRIGHT:
        return atan2(-yz, yy), pitch, 0.0
    return atan2(zy, zz), pitch, atan2(yx, xx)
