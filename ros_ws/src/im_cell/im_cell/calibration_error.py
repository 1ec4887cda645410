"""How wrong calibrated cameras are, expected or against true ones: reprojection and triangulation over given points."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from im_cell.camera_model import CameraModel
from im_core.errors import DataError

Array = NDArray[np.float64]

_ITERATIONS = 30
_CONVERGED_M = 1e-10


@dataclass(frozen=True)
class CalibrationError:
    """Errors of estimated cameras at points of the workspace: a map of sizes.

    Attributes:
        points: The points, shape (m, 3) [m].
        reprojection_px: RMS over the cameras that see a point of the length of the error of its projection, NaN where
            none does, shape (m,).
        triangulation_mm: Length of the error of the point triangulated from its noise-free images, RMS if expected,
            NaN where fewer than two cameras see it, shape (m,).
    """

    points: Array
    reprojection_px: Array
    triangulation_mm: Array

    @property
    def reprojection_rms_px(self) -> float:
        """RMS over all points [px]; NaN if no camera sees one."""
        return rms(self.reprojection_px)

    @property
    def triangulation_rms_mm(self) -> float:
        """RMS over all points [mm]; NaN if no two cameras see one."""
        return rms(self.triangulation_mm)


def rms(values: Array) -> float:
    """Return the root mean square of the values other than NaN; NaN if there are none."""
    known = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def evaluate(estimated: Sequence[CameraModel], true: Sequence[CameraModel], points: ArrayLike) -> CalibrationError:
    """Compare estimated cameras with the true ones.

    Args:
        estimated: Cameras as calibrated.
        true: The same cameras as they are, in the same order.
        points: Points of the workspace, shape (m, 3) [m].

    Returns:
        The errors at each point.

    Raises:
        DataError: The numbers of cameras differ, or the points are not an (m, 3) array.
    """
    where = np.asarray(points, dtype=float)
    if len(estimated) != len(true):
        raise DataError(f"{len(estimated)} estimated cameras cannot be compared with {len(true)} true ones.")
    if where.ndim != 2 or where.shape[1] != 3:
        raise DataError(f"The points have shape {where.shape}, it must be (m, 3).")
    images = np.stack([camera.project(where) for camera in true])
    seen = np.stack([camera.contains(image) for camera, image in zip(true, images, strict=True)])
    squared = np.stack(
        [((camera.project(where) - image) ** 2).sum(axis=1) for camera, image in zip(estimated, images, strict=True)]
    )
    count = seen.sum(axis=0)
    mean = np.where(seen, squared, 0.0).sum(axis=0) / np.maximum(count, 1)
    reprojection = np.where(count > 0, np.sqrt(mean), np.nan)
    both = count >= 2
    triangulation = np.full(len(where), np.nan)
    if both.any():
        found = triangulate(estimated, images[:, both], seen[:, both], where[both])
        triangulation[both] = 1e3 * np.linalg.norm(found - where[both], axis=1)
    return CalibrationError(where, reprojection, triangulation)


def triangulate(cameras: Sequence[CameraModel], images: ArrayLike, seen: ArrayLike, guess: ArrayLike) -> Array:
    """Compute the points with projections nearest to given images, by Gauss-Newton with equal weights.

    Args:
        cameras: The c cameras.
        images: Where they see the points, shape (c, m, 2) [px].
        seen: Which images count, at least two for each point, shape (c, m).
        guess: Where to start, shape (m, 3) [m].

    Returns:
        Points, shape (m, 3) [m]; NaN where a point went behind a camera.
    """
    uv, counts = np.asarray(images, dtype=float), np.asarray(seen, dtype=bool)
    x = np.array(guess, dtype=float)
    for _ in range(_ITERATIONS):
        residuals = np.stack([uv[c] - camera.project(x) for c, camera in enumerate(cameras)])
        jacobians = np.stack([camera.project_jacobian(x) for camera in cameras])
        residuals = np.where(counts[..., None], residuals, 0.0)
        jacobians = np.where(counts[..., None, None], jacobians, 0.0)
        normal = np.einsum("cmij,cmik->mjk", jacobians, jacobians)
        gradient = np.einsum("cmij,cmi->mj", jacobians, residuals)
        step = np.linalg.solve(normal, gradient[..., None])[..., 0]
        x = x + step
        if not np.nanmax(np.abs(step), initial=0.0) > _CONVERGED_M:
            break
    return x
