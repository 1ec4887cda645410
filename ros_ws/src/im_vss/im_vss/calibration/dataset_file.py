"""Observations as a data set of format ``vislab-calib-1``: what ``calibrate_dataset`` and ``next_best_pose`` read."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError
from im_vss.calibration.dataset import SCHEMA
from im_vss.calibration.problem import CalibrationProblem

Array = NDArray[np.float64]


def dataset_of(problem: CalibrationProblem) -> dict[str, Any]:
    """A data set of one trial, without truth; the inverse of :func:`im_vss.calibration.dataset.problems`.

    The format has one standard deviation a spot: the root of the mean variance of its coordinates.

    Args:
        problem: The observations.

    Raises:
        DataError: The images differ in size; the format has one size for all cameras.
    """
    if len(set(problem.image_sizes)) > 1:
        raise DataError(f"a data set has one image size for all cameras, not {sorted(set(problem.image_sizes))}")
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "camera_names": list(problem.camera_names),
        "pose_names": list(problem.pose_names),
        "image_size": list(problem.image_sizes[0]),
        "cov_x_m2": problem.position_covariances.tolist(),
        "sigma_u_px": _sigma(problem.spot_covariances).tolist(),
        "wrist_R_base": problem.wrist_rotations.tolist(),
        "led_offset_nominal_known": problem.led_offset_prior_sd == 0.0,
        "led_offset_prior_sd_m": problem.led_offset_prior_sd,
        "trials": [{"x_base_m": problem.positions.tolist(), "u_px": _spots(problem.spots)}],
    }
    if problem.joint_jacobians is not None:
        content |= {
            "J_joint": problem.joint_jacobians.tolist(),
            "joint_offset_prior_sd_rad": problem.joint_offset_prior_sd,
        }
    if (lengths := problem.lengths) is not None:
        content["known_lengths"] = {
            "length_m": lengths.lengths.tolist(),
            "sd_m": lengths.standard_deviations.tolist(),
            "sigma_u_px": _sigma(lengths.spot_covariances.mean(axis=2)).tolist(),
        }
        content["trials"][0]["length_u_px"] = [_spots(row) for row in lengths.spots]
    return content


def _sigma(covariances: Array) -> Array:
    """Standard deviation of a coordinate, shape (...), of covariances, shape (..., 2, 2) [px]."""
    return np.asarray(np.sqrt(np.trace(covariances, axis1=-2, axis2=-1) / 2.0))


def _spots(spots: Array) -> list[list[list[float] | None]]:
    """Spots, shape (m, n, 2), as lists; null where not detected."""
    return [[None if np.isnan(spot).any() else spot.tolist() for spot in row] for row in spots]
