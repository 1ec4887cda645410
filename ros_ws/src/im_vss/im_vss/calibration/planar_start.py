"""A start for LED positions that lie (nearly) in a plane, where the direct linear transformation has no answer."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ROUNDS = 15


def planar_start(
    points: Array, pixels: Array, image_size: tuple[int, int], tolerance: float
) -> tuple[Array, Array, Array] | None:
    """Pose and focal length from the homography of the plane, with the principal point in the middle of the image.

    Args:
        points: Nearly coplanar positions, shape (m, 3) [m].
        pixels: Their images, shape (m, 2) [px].
        image_size: Width and height [px].
        tolerance: Deviation that counts as small [px].

    Returns:
        fx, fy, cx, cy, rotation and translation; None if there is no such camera.
        Source: Zhang, "A flexible new technique for camera calibration" (2000), section 3.1.
    """
    centre = points.mean(axis=0)
    axes = np.linalg.svd(points - centre)[2]
    if np.linalg.det(axes) < 0.0:
        axes[2] = -axes[2]
    flat = (points - centre) @ axes[:2].T
    middle = (np.array(image_size) - 1.0) / 2.0
    width = float(image_size[0])
    homography = _homography(flat, (pixels - middle) / width, tolerance / width)
    focal = _focal_length(homography)
    columns = np.linalg.solve(np.diag([focal, focal, 1.0]), homography)
    scale = (np.linalg.norm(columns[:, 0]) + np.linalg.norm(columns[:, 1])) / 2.0
    if not np.isfinite(scale) or scale < 1e-12:
        return None
    columns = columns / scale * (1.0 if columns[2, 2] > 0.0 else -1.0)
    u, _, vt = np.linalg.svd(np.column_stack((columns[:, 0], columns[:, 1], np.cross(columns[:, 0], columns[:, 1]))))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt @ axes
    translation = columns[:, 2] - rotation @ centre
    if np.median(points @ rotation[2] + translation[2]) <= 0.0:
        return None
    return np.array([focal * width, focal * width, *middle]), rotation, translation


def _homography(flat: Array, image: Array, tolerance: float) -> Array:
    """Homography plane -> image by reweighted direct linear transformation, shape (3, 3)."""
    weights, homography = np.ones(len(flat)), np.eye(3)
    plane = np.column_stack((flat, np.ones(len(flat))))
    for _ in range(_ROUNDS):
        rows = np.zeros((len(flat), 2, 9))
        rows[:, 0, 0:3] = rows[:, 1, 3:6] = plane
        rows[:, :, 6:9] = -image[:, :, None] * plane[:, None, :]
        rows *= np.sqrt(weights)[:, None, None]
        homography = np.linalg.svd(rows.reshape(-1, 9))[2][-1].reshape(3, 3)
        mapped = plane @ homography.T
        depth = np.where(np.abs(mapped[:, 2]) > 1e-12, mapped[:, 2], 1e-12)
        squared = ((mapped[:, :2] / depth[:, None] - image) ** 2).sum(axis=1)
        scale = max(tolerance**2, 4.0 * float(np.median(squared)))
        weights = (1.0 + squared / scale) ** -2
    return np.asarray(homography)


def _focal_length(homography: Array) -> float:
    """Focal length in image widths from the two constraints of a plane; 1 where they give none in 0.3 ... 5."""
    h1, h2 = homography[:, 0], homography[:, 1]
    left = np.array([h1[2] * h2[2], h1[2] ** 2 - h2[2] ** 2])
    right = -np.array([h1[:2] @ h2[:2], h1[:2] @ h1[:2] - h2[:2] @ h2[:2]])
    square = float(left @ right) / max(float(left @ left), 1e-300)
    return float(np.sqrt(square)) if 0.09 < square < 25.0 else 1.0
