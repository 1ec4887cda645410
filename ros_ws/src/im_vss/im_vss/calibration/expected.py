"""Errors to expect in the workspace, from the covariance alone: what a user gets without knowing the truth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_core.workspace import Workspace
from im_vss.calibration.projection import project
from im_vss.calibration.unknowns import PER_CAMERA, Unknowns

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ExpectedError:
    """Predicted errors over the points of the workspace.

    Attributes:
        points: Points of the workspace, shape (m, 3) [m].
        reprojection_px: RMS length of the reprojection error at each point seen by a camera, NaN elsewhere, shape (m,).
        triangulation_mm: RMS length of the triangulation error at each point seen by two cameras, NaN elsewhere, (m,).
    """

    points: Array
    reprojection_px: Array
    triangulation_mm: Array

    @property
    def reprojection_rms_px(self) -> float:
        """RMS over the workspace [px]; NaN if no camera sees it."""
        return rms(self.reprojection_px)

    @property
    def triangulation_rms_mm(self) -> float:
        """RMS over the workspace [mm]; NaN if no two cameras see a common part of it."""
        return rms(self.triangulation_mm)


def rms(values: Array) -> float:
    """Root mean square of the values that are not NaN; NaN if there are none."""
    known = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def expected_error(
    unknowns: Unknowns, covariance: Array, image_sizes: tuple[tuple[int, int], ...], workspace: Workspace
) -> ExpectedError:
    """Propagate the covariance of the cameras to points of the workspace, to first order.

    Triangulation is from noise-free images, least squares in all cameras that see the point: with A the derivatives of
    the images by the point and B by the parameters, the point moves by ``-(A^T A)^-1 A^T B d(parameters)``.

    Args:
        unknowns: The estimate.
        covariance: Covariance of all unknowns, cameras first, shape (size, size).
        image_sizes: Width and height of each image [px].
        workspace: Where.
    """
    points = workspace.grid()
    c, m = len(image_sizes), len(points)
    pixels, by_point, by_camera = project(unknowns.intrinsics, unknowns.rotations, unknowns.translations, points)
    limits = np.array(image_sizes, dtype=float)[:, None, :] - 0.5
    seen = np.all((pixels > -0.5) & (pixels < limits), axis=2)
    by_point = np.where(seen[..., None, None], by_point, 0.0)
    by_camera = np.where(seen[..., None, None], by_camera, 0.0)
    cameras = covariance[: PER_CAMERA * c, : PER_CAMERA * c]

    variance = np.zeros((c, m))
    gain = np.zeros((m, 3, PER_CAMERA * c))
    for camera in range(c):
        block = slice(PER_CAMERA * camera, PER_CAMERA * (camera + 1))
        variance[camera] = np.einsum("mij,jk,mik->m", by_camera[camera], cameras[block, block], by_camera[camera])
        gain[:, :, block] = np.swapaxes(by_point[camera], 1, 2) @ by_camera[camera]
    count = seen.sum(axis=0)
    reprojection = np.where(count > 0, np.sqrt(variance.sum(axis=0) / np.maximum(count, 1)), np.nan)
    triangulation = np.full(m, np.nan)
    both = count >= 2
    if both.any():
        normal = np.einsum("cmij,cmik->mjk", by_point, by_point)[both]
        gain = np.linalg.solve(normal, gain[both])
        triangulation[both] = 1e3 * np.sqrt(np.einsum("mij,jk,mik->m", gain, cameras, gain))
    return ExpectedError(points, reprojection, triangulation)
