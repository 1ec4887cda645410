"""Covariance of the light against sampling, and the check of the rest."""

import numpy as np
import pytest

from im_calibration.light import Array, MeasuredRest
from im_cell.rotations import matrix_of_quaternion
from im_core.errors import DataError


def rest(jacobian: Array, q_covariance: Array, rotation: Array | None = None, since_ns: int = 0) -> MeasuredRest:
    return MeasuredRest(jacobian, q_covariance, np.eye(3) if rotation is None else rotation, since_ns)


def test_covariance_agrees_with_sampling_of_a_turning_wrist() -> None:
    """Two joints: a slide along x and a turn about z; the light's position is known in closed form."""
    offset = np.array([0.0, 0.3, 0.1])
    rotation = matrix_of_quaternion([0.0, 0.0, np.sin(0.35), np.cos(0.35)])
    jacobian = np.zeros((6, 2))
    jacobian[0, 0] = 1.0
    jacobian[5, 1] = 1.0
    deviations = np.array([1e-3, 2e-3])
    covariance = rest(jacobian, np.diag(deviations**2), rotation).point_covariance(offset)
    samples = np.random.default_rng(1).normal(size=(40_000, 2)) * deviations
    half, zero = 0.5 * (0.7 + samples[:, 1]), np.zeros(len(samples))
    points = matrix_of_quaternion(np.stack((zero, zero, np.sin(half), np.cos(half)), axis=1)) @ offset
    points[:, 0] += samples[:, 0]
    np.testing.assert_allclose(covariance, np.cov(points.T), atol=3e-8)


def test_wrong_sizes_and_infinities_are_refused() -> None:
    with pytest.raises(DataError, match=r"\(6, 3\) does not fit"):
        rest(np.zeros((6, 3)), np.eye(2)).point_covariance(np.zeros(3))
    with pytest.raises(DataError, match="not finite"):
        rest(np.full((6, 2), np.nan), np.eye(2)).point_covariance(np.zeros(3))


def test_an_exposure_before_the_rest_is_refused() -> None:
    at = rest(np.zeros((6, 2)), np.eye(2), since_ns=1_500_000)
    at.require_shown(1_500_000, "p1")
    with pytest.raises(DataError, match=r"pose p1: the image was exposed 0\.0005 s before") as caught:
        at.require_shown(1_000_000, "p1")
    assert caught.value.code == "unusable"
