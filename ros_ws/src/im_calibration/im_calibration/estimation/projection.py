"""Projection of points into cameras with its derivatives by the point and by all 14 parameters of the camera."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def project(intrinsics: Array, rotations: Array, translations: Array, points: Array) -> tuple[Array, Array, Array]:
    """Project points into each of c cameras (`plumb_bob` with k3 = 0).

    Args:
        intrinsics: fx, fy, cx, cy, k1, k2, p1, p2 of each camera, shape (c, 8).
        rotations: Rotations base -> camera, shape (c, 3, 3).
        translations: Base origin in the camera frames, shape (c, 3) [m].
        points: Points in the base frame, shape (n, 3) [m].

    Returns:
        Pixels (c, n, 2), NaN behind a camera; derivatives by the point (c, n, 2, 3) [px/m]; derivatives by the camera's
        parameters in the order of :data:`im_calibration.estimation.unknowns.CAMERA_PARAMETERS` (c, n, 2, 14).
    """
    rotated = points @ np.swapaxes(rotations, 1, 2)
    x, y, depth = _ideal(rotated + translations[:, None, :])
    fx, fy, cx, cy, k1, k2, p1, p2 = (intrinsics[:, i, None] for i in range(8))
    r2, xy = x * x + y * y, x * y
    radial = 1.0 + r2 * (k1 + r2 * k2)
    xd, yd = _distorted(x, y, intrinsics)

    lens = np.empty((*x.shape, 2, 2))
    slope = 2.0 * (k1 + 2.0 * k2 * r2)
    lens[..., 0, 0] = fx * (radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x)
    lens[..., 0, 1] = fx * (slope * xy + 2.0 * p1 * x + 2.0 * p2 * y)
    lens[..., 1, 0] = fy * (slope * xy + 2.0 * p1 * x + 2.0 * p2 * y)
    lens[..., 1, 1] = fy * (radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x)
    by_camera_frame = np.empty((*x.shape, 2, 3))
    by_camera_frame[..., :2] = lens / depth[..., None, None]
    by_camera_frame[..., 2] = -(lens[..., 0] * x[..., None] + lens[..., 1] * y[..., None]) / depth[..., None]

    by_parameters = np.zeros((*x.shape, 2, 14))
    by_parameters[..., 0, 0], by_parameters[..., 1, 1] = xd, yd
    by_parameters[..., 0, 2] = by_parameters[..., 1, 3] = 1.0
    by_parameters[..., 0, 4], by_parameters[..., 1, 4] = fx * x * r2, fy * y * r2
    by_parameters[..., 0, 5], by_parameters[..., 1, 5] = fx * x * r2 * r2, fy * y * r2 * r2
    by_parameters[..., 0, 6], by_parameters[..., 1, 6] = fx * 2.0 * xy, fy * (r2 + 2.0 * y * y)
    by_parameters[..., 0, 7], by_parameters[..., 1, 7] = fx * (r2 + 2.0 * x * x), fy * 2.0 * xy
    # A small rotation w in the camera frame moves the point by w x (R X), hence the row vector (R X) x d.
    by_parameters[..., 8:11] = np.cross(rotated[..., None, :], by_camera_frame)
    by_parameters[..., 11:] = by_camera_frame

    pixels = np.stack((fx * xd + cx, fy * yd + cy), axis=-1)
    return pixels, np.asarray(by_camera_frame @ rotations[:, None]), by_parameters


def image(intrinsics: Array, rotations: Array, translations: Array, points: Array) -> Array:
    """Pixels as of :func:`project`, without the derivatives, shape (c, n, 2)."""
    x, y, _ = _ideal(points @ np.swapaxes(rotations, 1, 2) + translations[:, None, :])
    xd, yd = _distorted(x, y, intrinsics)
    return np.stack((xd, yd), axis=-1) * intrinsics[:, None, 0:2] + intrinsics[:, None, 2:4]


def _ideal(in_camera: Array) -> tuple[Array, Array, Array]:
    """Ideal image coordinates x, y and depth, NaN behind the camera, each of shape (c, n)."""
    depth = np.where(in_camera[..., 2] > 0.0, in_camera[..., 2], np.nan)
    return in_camera[..., 0] / depth, in_camera[..., 1] / depth, depth


def _distorted(x: Array, y: Array, intrinsics: Array) -> tuple[Array, Array]:
    """Ideal coordinates after the lens, each of shape (c, n)."""
    k1, k2, p1, p2 = (intrinsics[:, i, None] for i in range(4, 8))
    r2, xy = x * x + y * y, x * y
    radial = 1.0 + r2 * (k1 + r2 * k2)
    xd = x * radial + 2.0 * p1 * xy + p2 * (r2 + 2.0 * x * x)
    return xd, y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * xy
