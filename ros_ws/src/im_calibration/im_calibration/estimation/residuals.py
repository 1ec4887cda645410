"""Residuals of all spots, with derivatives, and with covariance after elimination of the LED positions.

The uncertain LED positions X_i are unknowns that the cameras share. The normal equations of everything have one 3x3
block for each; taking its Schur complement leaves equations in the parameters alone, whose residuals have the
covariance ``S_i = Sigma_u + A_i C_i A_i^T``: A_i are the derivatives of all spots of pose i by X_i, C_i is the
covariance of the measured position, and the blocks off the diagonal carry what the cameras have in common. Source:
Triggs et al., "Bundle adjustment - a modern synthesis" (2000), section 6; the identity is the matrix inversion lemma.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.projection import image, project
from im_calibration.estimation.unknowns import ParameterLayout, Unknowns
from im_calibration.problem.problem import CalibrationProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_NEAREST_SHARE = 0.03  # of the typical depth: nearer, hardly anything of the geometry is linear


@dataclass(frozen=True)
class Linearisation:
    """The problem around a value of the unknowns, n poses in c cameras; rows where no spot counts are zero.

    Attributes:
        residuals: Measured spots minus those predicted from the robot's positions, linearised at the estimated
            positions, shape (n, 2c) [px].
        by_point: Derivatives of the predictions by the LED position, shape (n, 2c, 3) [px/m].
        jacobians: Derivatives of the predictions by the unknowns, shape (n, 2c, size).
        covariances: Covariances S of the residuals, unit rows where no spot counts, shape (n, 2c, 2c) [px^2].
    """

    residuals: Array
    by_point: Array
    jacobians: Array
    covariances: Array


def linearise(
    unknowns: Unknowns,
    problem: CalibrationProblem,
    layout: ParameterLayout,
    used: Mask,
    image_covariances: Array | None = None,
) -> Linearisation:
    """Linearise the problem.

    Args:
        unknowns: Where; every used spot must lie in front of its camera.
        problem: The observations.
        layout: Places of the unknowns.
        used: Which spots count, shape (c, n).
        image_covariances: Covariances of the spots, shape (c, n, 2, 2) [px^2]; None: those of the problem.
    """
    pixels, by_point, by_camera = project(unknowns, unknowns.led_positions(problem))
    c, n = used.shape
    residuals = by_pose(np.where(used[..., None], problem.spots - pixels, 0.0))
    stacked = np.ascontiguousarray(np.swapaxes(np.where(used[..., None, None], by_point, 0.0), 0, 1)).reshape(
        n, 2 * c, 3
    )
    jacobians = np.zeros((n, 2 * c, layout.size))
    for camera in range(c):
        jacobians[:, 2 * camera : 2 * camera + 2, layout.camera_slice(camera)] = np.where(
            used[camera, :, None, None], by_camera[camera], 0.0
        )
    if layout.led:
        jacobians[:, :, layout.led_slice] = stacked @ problem.wrist_rotations
    if layout.joints and problem.joint_jacobians is not None:
        jacobians[:, :, layout.joint_slice] = stacked @ problem.joint_jacobians
    if problem.arm_error is not None:
        jacobians[:, :, layout.arm_slice] = stacked @ problem.arm_error.jacobians
    if layout.shared:
        jacobians[:, :, layout.shared_slice] = stacked @ problem.shared_errors
    if problem.placements is not None:
        local = stacked @ problem.placements.jacobians(unknowns.placements)
        poses = np.flatnonzero(problem.placements.of >= 0)
        columns = layout.placed_slice.start + 6 * problem.placements.of[poses, None] + np.arange(6)
        jacobians[poses[:, None, None], np.arange(2 * c)[:, None], columns[:, None, :]] = local[poses]

    covariances = stacked @ problem.own_covariances @ np.swapaxes(stacked, 1, 2)
    noise = problem.spot_covariances if image_covariances is None else image_covariances
    noise = np.where(used[..., None, None], noise, np.eye(2))
    for camera in range(c):
        rows = slice(2 * camera, 2 * camera + 2)
        covariances[:, rows, rows] += noise[camera]
    residuals = residuals + (stacked @ unknowns.displacements[..., None])[..., 0]
    return Linearisation(residuals, stacked, jacobians, covariances)


def image_residuals(unknowns: Unknowns, problem: CalibrationProblem, used: Mask) -> Array | None:
    """Return spots minus images of estimated positions, shape (n, 2c) [px]; None if a used spot is behind a camera."""
    pixels = image(unknowns, unknowns.led_positions(problem))
    if not np.all(np.isfinite(pixels[used])):
        return None
    return by_pose(np.where(used[..., None], problem.spots - pixels, 0.0))


def projectable(unknowns: Unknowns, problem: CalibrationProblem) -> Mask:
    """Mark estimated LED positions in front of a camera, and not much nearer than most, shape (c, n)."""
    points = unknowns.led_positions(problem)
    depth = np.einsum("cx,nx->cn", unknowns.rotations[:, 2], points) + unknowns.translations[:, 2, None]
    return np.asarray(depth > _NEAREST_SHARE * np.maximum(np.median(depth, axis=1), 0.0)[:, None])


def by_pose(spots: Array) -> Array:
    """Coordinates of all cameras in a row for each pose, shape (c, n, 2) -> (n, 2c)."""
    return np.ascontiguousarray(np.swapaxes(spots, 0, 1)).reshape(spots.shape[1], -1)


def camera_blocks(matrices: Array) -> Array:
    """The 2x2 blocks on the diagonal, shape (n, 2c, 2c) -> (c, n, 2, 2)."""
    count = matrices.shape[1] // 2
    return np.stack([matrices[:, 2 * c : 2 * c + 2, 2 * c : 2 * c + 2] for c in range(count)])
