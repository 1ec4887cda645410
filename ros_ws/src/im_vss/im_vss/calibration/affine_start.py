"""A start for few or poor observations, where the direct linear transformation ends in no camera one can build."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ROUNDS = 15
_FOCAL_LENGTHS = (0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0)


def affine_start(
    points: Array, pixels: Array, image_size: tuple[int, int], tolerance: float
) -> tuple[Array, Array, Array] | None:
    """Orientation and scale from the affine camera, which has 8 unknowns only; then the likeliest focal length.

    Args:
        points: Positions that fill a volume, shape (m, 3) [m].
        pixels: Their images, shape (m, 2) [px].
        image_size: Width and height [px].
        tolerance: Deviation that counts as small [px].

    Returns:
        fx, fy, cx, cy, rotation and translation; None if there is no such camera.
        Source: Hartley and Zisserman, "Multiple View Geometry", 2nd ed., sections 6.3 and 7.3.
    """
    linear, centre, image = _affine_camera(points, pixels, tolerance)
    u, values, vt = np.linalg.svd(linear, full_matrices=False)
    if values[1] < 1e-9:
        return None
    rows = u @ vt
    rotation = np.vstack((rows, np.cross(rows[0], rows[1])))
    middle = (np.array(image_size) - 1.0) / 2.0
    best, found = np.inf, None
    for focal in image_size[0] * np.array(_FOCAL_LENGTHS):
        depth = focal / values.mean()
        translation = depth * np.append((image - middle) / focal, 1.0) - rotation @ centre
        in_camera = points @ rotation.T + translation
        ahead = in_camera[:, 2] > 0.1 * depth
        predicted = focal * in_camera[:, :2] / np.where(ahead, in_camera[:, 2], 1.0)[:, None] + middle
        squared = np.where(ahead, ((predicted - pixels) ** 2).sum(axis=1), np.inf)
        cost = float((1.0 - 1.0 / (1.0 + squared / tolerance**2)).sum())
        if cost < best:
            best, found = cost, (np.array([focal, focal, *middle]), rotation, translation)
    return found


def _affine_camera(points: Array, pixels: Array, tolerance: float) -> tuple[Array, Array, Array]:
    """Robust linear map of points to pixels about their centres: matrix (2, 3) [px/m], centre [m], its image [px]."""
    weights = np.ones(len(points))
    linear, centre, image = np.zeros((2, 3)), points.mean(axis=0), pixels.mean(axis=0)
    for _ in range(_ROUNDS):
        share = weights / weights.sum()
        centre, image = share @ points, share @ pixels
        root = np.sqrt(weights)[:, None]
        linear = np.linalg.lstsq(root * (points - centre), root * (pixels - image), rcond=None)[0].T
        squared = ((pixels - image - (points - centre) @ linear.T) ** 2).sum(axis=1)
        scale = max(tolerance**2, 4.0 * float(np.median(squared)))
        weights = (1.0 + squared / scale) ** -2
    return linear, centre, image
