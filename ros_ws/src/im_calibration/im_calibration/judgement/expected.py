"""Errors to expect in workspace and images, from the covariance alone: the user's errors, without known truth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.projection import project
from im_calibration.estimation.unknowns import Unknowns
from im_cell.calibration_error import CalibrationError, rms
from im_cell.camera_model import CameraModel
from im_cell.workspace import Workspace

Array = NDArray[np.float64]

_COLUMNS, _ROWS = 13, 9
_RIM_RATIO, _RIM_PX = 3.0, 0.5


@dataclass(frozen=True)
class ImageError:
    """Errors to expect of one camera over the image, at the distance of the spots.

    Attributes:
        u: Columns of a grid over the image, edges included, shape (k,) [px].
        v: Rows of it, shape (m,) [px].
        expected_px: Standard deviation of a projection there, NaN where the lens folds the image, shape (m, k).
        at_spots_px: The same where the spots are, RMS.
    """

    u: Array
    v: Array
    expected_px: Array
    at_spots_px: float

    @property
    def largest_px(self) -> float:
        """Largest of the errors [px]; infinite where the lens folds the image."""
        return float(np.nan_to_num(self.expected_px, nan=np.inf).max())

    @property
    def limit_px(self) -> float:
        """Largest error that is like that at the spots [px]."""
        return max(_RIM_RATIO * self.at_spots_px, _RIM_PX)

    @property
    def region(self) -> tuple[float, float, float, float]:
        """Rectangle with errors like those at the spots: least and largest u, least and largest v; or NaN [px]."""
        good = self.expected_px <= self.limit_px
        left, right, top, bottom = 0, len(self.u), 0, len(self.v)
        while left < right and top < bottom and not (inner := good[top:bottom, left:right]).all():
            sides = [inner[:, 0].mean(), inner[:, -1].mean(), inner[0].mean(), inner[-1].mean()]
            worst = int(np.argmin(sides))  # the side with most that is not good
            left, right = left + (worst == 0), right - (worst == 1)
            top, bottom = top + (worst == 2), bottom - (worst == 3)
        if left >= right or top >= bottom:
            return float("nan"), float("nan"), float("nan"), float("nan")
        return float(self.u[left]), float(self.u[right - 1]), float(self.v[top]), float(self.v[bottom - 1])

    @property
    def told(self) -> str:
        """Clause on a rim of the image where the camera is known far less well; empty if there is none."""
        if self.largest_px <= self.limit_px:
            return ""
        most = f"up to {self.largest_px:.2g} px" if np.isfinite(self.largest_px) else "anything"
        left, right, top, bottom = self.region
        within = f"u {left:.0f} to {right:.0f}, v {top:.0f} to {bottom:.0f}"
        return (
            f"expect {self.at_spots_px:.2g} px where the spots are, and {most} at the rim of the image; "
            f"below {self.limit_px:.2g} px within {within}"
        )


def image_error(unknowns: Unknowns, covariance: Array, c: int, model: CameraModel, points: Array) -> ImageError:
    """Propagate the covariance of a camera to the whole image, to first order.

    Args:
        unknowns: The estimate.
        covariance: Covariance of the parameters of the camera, shape (k, k).
        c: Which camera.
        model: The same camera.
        points: Where it saw the LED, shape (n, 3) [m].
    """

    def expected(where: Array) -> Array:
        by_camera = project(unknowns, where)[2][c]
        return np.asarray(np.sqrt(np.einsum("mij,jk,mik->m", by_camera, covariance, by_camera)))

    u, v = np.linspace(0.0, model.width - 1.0, _COLUMNS), np.linspace(0.0, model.height - 1.0, _ROWS)
    depth = float(np.median(points @ model.R_cam_base[2] + model.t_cam_base[2])) if len(points) else 1.0
    grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    ideal = np.column_stack((model.undistort_or_nan(grid), np.ones(len(grid))))
    over_image = expected((depth * ideal - model.t_cam_base) @ model.R_cam_base)
    return ImageError(u, v, over_image.reshape(_ROWS, _COLUMNS), rms(expected(points)))


@dataclass(frozen=True)
class Sensitivity:
    """How errors of c cameras show at m points of a workspace, to first order.

    Attributes:
        points: The points, shape (m, 3) [m].
        seen: Which camera sees which point, shape (c, m).
        pixels: Derivatives of the images by each camera's parameters, 0 where not seen, c of shape (m, 2, k).
        points_moved: Derivatives of the triangulated points by the parameters of all cameras, NaN where fewer than two
            cameras see the point, shape (m, 3, all k) [m].
    """

    points: Array
    seen: NDArray[np.bool_]
    pixels: tuple[Array, ...]
    points_moved: Array

    def reprojection_weight(self) -> Array:
        """Return W, with ``trace(W P)`` the mean square reprojection error by a covariance P, (all k, all k) [px^2]."""
        count = self.seen.sum(axis=0)
        shares = np.where(count > 0, 1.0, 0.0) / np.maximum(count, 1) / max(1, int((count > 0).sum()))
        blocks = camera_blocks_of(self.pixels)
        weight = np.zeros((blocks[-1].stop, blocks[-1].stop))
        for camera, block in enumerate(blocks):
            weight[block, block] = np.einsum("m,mia,mib->ab", shares, self.pixels[camera], self.pixels[camera])
        return weight

    def triangulation_weight(self) -> Array | None:
        """Return W, with ``trace(W P)`` the mean square triangulation error, (all k, all k) [mm^2]; or None."""
        known = self.points_moved[self.seen.sum(axis=0) >= 2]
        if not len(known):
            return None
        return np.asarray(1e6 * np.einsum("mia,mib->ab", known, known) / len(known))


def sensitivity(unknowns: Unknowns, image_sizes: tuple[tuple[int, int], ...], workspace: Workspace) -> Sensitivity:
    """Linearise images and triangulation over a workspace.

    Triangulation is from noise-free images, least squares in all cameras that see the point: with A the derivatives of
    the images by the point and B by the parameters, the point moves by ``-(A^T A)^-1 A^T B d(parameters)``.

    Args:
        unknowns: The cameras.
        image_sizes: Width and height of each image [px].
        workspace: Where.
    """
    points = workspace.grid()
    pixels, by_point, by_camera = project(unknowns, points)
    seen = inside(pixels, image_sizes)
    by_point = np.where(seen[..., None, None], by_point, 0.0)
    by_camera = tuple(np.where(seen[c, :, None, None], one, 0.0) for c, one in enumerate(by_camera))
    both = seen.sum(axis=0) >= 2
    blocks = camera_blocks_of(by_camera)
    moved = np.zeros((len(points), 3, blocks[-1].stop))
    for camera, block in enumerate(blocks):
        moved[:, :, block] = -np.swapaxes(by_point[camera], 1, 2) @ by_camera[camera]
    moved[~both] = np.nan
    if both.any():
        normal = np.einsum("cmij,cmik->mjk", by_point, by_point)[both]
        moved[both] = np.linalg.solve(normal, moved[both])
    return Sensitivity(points, seen, by_camera, moved)


def camera_blocks_of(by_cameras: Sequence[Array]) -> tuple[slice, ...]:
    """Return the places of the cameras' parameters one after the other, given derivatives by the parameters."""
    ends = np.cumsum([one.shape[-1] for one in by_cameras])
    return tuple(slice(int(end) - one.shape[-1], int(end)) for one, end in zip(by_cameras, ends, strict=True))


def inside(pixels: Array, image_sizes: tuple[tuple[int, int], ...]) -> NDArray[np.bool_]:
    """Mark the pixels inside the images, shape (c, m, 2) -> (c, m)."""
    limits = np.array(image_sizes, dtype=float)[:, None, :] - 0.5
    return np.asarray(np.all((pixels > -0.5) & (pixels < limits), axis=2))


def expected_error(
    unknowns: Unknowns, covariance: Array, image_sizes: tuple[tuple[int, int], ...], workspace: Workspace
) -> CalibrationError:
    """Propagate the covariance of the cameras to points of the workspace, to first order.

    Args:
        unknowns: The estimate.
        covariance: Covariance of all unknowns, cameras first, shape (size, size).
        image_sizes: Width and height of each image [px].
        workspace: Where.
    """
    gains = sensitivity(unknowns, image_sizes, workspace)
    blocks = camera_blocks_of(gains.pixels)
    cameras = covariance[: blocks[-1].stop, : blocks[-1].stop]
    variance = np.zeros(gains.seen.shape)
    for camera, block in enumerate(blocks):
        by_camera = gains.pixels[camera]
        variance[camera] = np.einsum("mij,jk,mik->m", by_camera, cameras[block, block], by_camera)
    count = gains.seen.sum(axis=0)
    reprojection = np.where(count > 0, np.sqrt(variance.sum(axis=0) / np.maximum(count, 1)), np.nan)
    triangulation = 1e3 * np.sqrt(np.einsum("mij,jk,mik->m", gains.points_moved, cameras, gains.points_moved))
    return CalibrationError(gains.points, reprojection, np.asarray(triangulation))
