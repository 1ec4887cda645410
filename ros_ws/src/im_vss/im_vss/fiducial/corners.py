"""Corners of a fiducial's black square, as the intersections of its four edges."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_core.camera_model import CameraModel
from im_vss.edges.band import Image, StraightEdge, follow_edge
from im_vss.spot import SensorNoise

Array = NDArray[np.float64]

_MARGIN_SHARE = 0.12
_SMALLEST_HALF_PX, _CELLS_HALF = 2.0, 0.5


@dataclass(frozen=True)
class Corners:
    """Four corners in undistorted pixels, shape (4, 2) [px], and their joint covariance, shape (8, 8) [px^2]."""

    uv: Array
    covariance: Array


def refine_corners(image: Image, camera: CameraModel, rough: Array, cells: int, noise: SensorNoise) -> Corners | None:
    """Fit the four edges of a black square on white, and intersect them.

    Args:
        image: Pixels, shape (h, w) [DN].
        camera: Intrinsics and lens.
        rough: Corners as detected, clockwise, shape (4, 2) [px].
        cells: Cells along a side: the border's width says how far from an edge pixels may be used.
        noise: Noise of the sensor.

    Returns:
        The corners in the same order, None where an edge cannot be fitted.

    Raises:
        DataError: The lens model cannot be inverted there.
    """
    edges: list[StraightEdge] = []
    for k in range(4):
        ends = rough[[k, (k + 1) % 4]]
        length = float(np.linalg.norm(ends[1] - ends[0]))
        half = max(_SMALLEST_HALF_PX, _CELLS_HALF * length / cells)
        edge = follow_edge(image, camera, ends, half, _MARGIN_SHARE * length, noise)
        if edge is None:
            return None
        edges.append(edge)
    uv, jacobian, covariance = np.zeros((4, 2)), np.zeros((8, 8)), np.zeros((8, 8))
    for k in range(4):
        first, second = (k - 1) % 4, k
        normals = np.stack([edges[first].normal, edges[second].normal])
        uv[k] = np.linalg.solve(normals, [n @ edges[e].middle for n, e in zip(normals, (first, second), strict=True)])
        inverse = np.linalg.inv(normals)
        for column, e in enumerate((first, second)):
            arm = float((uv[k] - edges[e].middle) @ edges[e].direction)
            jacobian[2 * k : 2 * k + 2, 2 * e : 2 * e + 2] = np.outer(inverse[:, column], [1.0, arm])
        covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = edges[k].fit.covariance
    return Corners(uv, jacobian @ covariance @ jacobian.T)
