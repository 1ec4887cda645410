"""A laser line seen by two cameras: a place in one is matched where its epipolar line crosses the line in the other."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_core.camera_model import CameraModel
from im_vss.stereo import essential_matrix

Array = NDArray[np.float64]

_NEIGHBOURS_PX = 4.0


@dataclass(frozen=True)
class LineMatches:
    """Places that were matched.

    Attributes:
        points: In the world, shape (k, 3) [m].
        places: Which of the first camera's places each is, shape (k,).
        rejected: Places of the first camera without a point, by cause.
    """

    points: Array
    places: NDArray[np.int64]
    rejected: dict[str, int]


def match_lines(cameras: tuple[CameraModel, CameraModel], first: Array, second: Array) -> LineMatches:
    """Triangulate a line.

    Args:
        cameras: Two, with their poses.
        first: Places of the line in the first, in order along it, shape (n, 2) [px].
        second: The same in the second, shape (m, 2) [px].

    Raises:
        DataError: The lens model cannot be inverted at a place.
    """
    x, y = (_ideal(camera, pixels) for camera, pixels in zip(cameras, (first, second), strict=True))
    side = x @ essential_matrix(*cameras).T @ y.T
    next_to = np.linalg.norm(np.diff(second, axis=0), axis=1) <= _NEIGHBOURS_PX
    crosses = (np.sign(side[:, :-1]) != np.sign(side[:, 1:])) & next_to
    count = crosses.sum(axis=1)
    places = np.flatnonzero(count == 1)
    here = crosses[places].argmax(axis=1)
    before, after = side[places, here], side[places, here + 1]
    share = (before / (before - after))[:, None]
    matched = (1.0 - share) * y[here] + share * y[here + 1]
    causes = {"no match in the other camera": count == 0, "more than one match in the other camera": count > 1}
    rejected = {cause: int(which.sum()) for cause, which in causes.items() if which.any()}
    return LineMatches(_nearest(cameras, x[places], matched), places, rejected)


def _ideal(camera: CameraModel, pixels: Array) -> Array:
    """Ideal images on the plane z = 1, shape (n, 3) [-], of pixels, shape (n, 2)."""
    return np.column_stack((camera.undistort(pixels).reshape(-1, 2), np.ones(len(pixels))))


def _nearest(cameras: tuple[CameraModel, CameraModel], x: Array, y: Array) -> Array:
    """Points half way between pairs of rays, where they are nearest, shape (k, 3) [m]; rays by ideal images."""
    u, v = x @ cameras[0].R_cam_base, y @ cameras[1].R_cam_base
    base = cameras[1].position - cameras[0].position
    uu, uv, vv = (np.einsum("ni,ni->n", a, b) for a, b in ((u, u), (u, v), (v, v)))
    along = (vv * (u @ base) - uv * (v @ base)) / (uu * vv - uv**2)
    across = (uv * (u @ base) - uu * (v @ base)) / (uu * vv - uv**2)
    ends = cameras[0].position + along[:, None] * u, cameras[1].position + across[:, None] * v
    return np.asarray(0.5 * (ends[0] + ends[1]))
