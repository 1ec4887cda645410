"""Projection of points into cameras, with derivatives by the point and by all parameters of the camera."""

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.unknowns import Unknowns

Array = NDArray[np.float64]


def project(unknowns: Unknowns, points: Array) -> tuple[Array, Array, tuple[Array, ...]]:
    """Project points into each of c cameras.

    Args:
        unknowns: The cameras.
        points: Points in the base frame, shape (n, 3) [m].

    Returns:
        Pixels (c, n, 2), NaN behind a camera; derivatives by the point (c, n, 2, 3) [px/m]; for each camera,
        derivatives by its parameters in the order of :func:`im_calibration.estimation.unknowns.camera_parameters`
        (n, 2, parameters).
    """
    rotated = points @ np.swapaxes(unknowns.rotations, 1, 2)
    x, y, depth = _ideal(rotated + unknowns.translations[:, None, :])
    pixels = np.empty((*x.shape, 2))
    by_camera_frame = np.empty((*x.shape, 2, 3))
    by_parameters = []
    for c, lens in enumerate(unknowns.lenses):
        (fx, fy, cx, cy), D = unknowns.intrinsics[c, :4], unknowns.coefficients(c)
        xn = np.stack((x[c], y[c]), axis=-1)
        distorted, by_ideal = lens.distort(xn, D), np.array([[fx], [fy]]) * lens.jacobian(xn, D)
        frame = by_camera_frame[c]
        frame[..., :2] = by_ideal / depth[c, :, None, None]
        along = by_ideal[..., 0] * xn[..., None, 0] + by_ideal[..., 1] * xn[..., None, 1]
        frame[..., 2] = -along / depth[c, :, None]
        found = np.zeros((len(points), 2, 10 + lens.estimated))
        found[:, 0, 0], found[:, 1, 1] = distorted[:, 0], distorted[:, 1]
        found[:, 0, 2] = found[:, 1, 3] = 1.0
        found[..., 4:-6] = lens.by_coefficients(xn, D, (float(fx), float(fy)))[..., : lens.estimated]
        # A small rotation w in the camera frame moves the point by w x (R X), hence the row vector (R X) x d.
        _cross(rotated[c][:, None, :], frame, found[..., -6:-3])
        found[..., -3:] = frame
        by_parameters.append(found)
        pixels[c] = distorted * (fx, fy) + (cx, cy)
    return pixels, np.asarray(by_camera_frame @ unknowns.rotations[:, None]), tuple(by_parameters)


def _cross(a: Array, b: Array, result: Array) -> None:
    """Compute the vector products of the rows; `np.cross` spends most time on handling unspecified axes."""
    for axis, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        result[..., axis] = a[..., i] * b[..., j] - a[..., j] * b[..., i]


def image(unknowns: Unknowns, points: Array) -> Array:
    """Return pixels as of :func:`project`, without the derivatives, shape (c, n, 2)."""
    x, y, _ = _ideal(points @ np.swapaxes(unknowns.rotations, 1, 2) + unknowns.translations[:, None, :])
    pixels = np.empty((*x.shape, 2))
    for c, lens in enumerate(unknowns.lenses):
        distorted = lens.distort(np.stack((x[c], y[c]), axis=-1), unknowns.coefficients(c))
        pixels[c] = distorted * unknowns.intrinsics[c, 0:2] + unknowns.intrinsics[c, 2:4]
    return pixels


def _ideal(in_camera: Array) -> tuple[Array, Array, Array]:
    """Ideal image coordinates x, y and depth, NaN behind the camera, each of shape (c, n)."""
    depth = np.where(in_camera[..., 2] > 0.0, in_camera[..., 2], np.nan)
    return in_camera[..., 0] / depth, in_camera[..., 1] / depth, depth
