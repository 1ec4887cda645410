"""Covariance of the light against sampling, and the check of the rest."""

import numpy as np
import pytest

from im_calibration.light import Array, MeasuredRest, rotation_of
from im_core.errors import DataError


def rest(jacobian: Array, q_covariance: Array, rotation: Array | None = None, since_ns: int = 0) -> MeasuredRest:
    return MeasuredRest(jacobian, q_covariance, np.eye(3) if rotation is None else rotation, since_ns)


def rotation_about(axis: np.ndarray, angle: float) -> np.ndarray:
    half = 0.5 * angle
    return rotation_of(*(np.sin(half) * axis), np.cos(half))


def test_covariance_agrees_with_sampling_of_a_turning_wrist() -> None:
    """Two joints: a slide along x and a turn about z; the light's position is known in closed form."""
    offset = np.array([0.0, 0.3, 0.1])
    rotation = rotation_about(np.array([0.0, 0.0, 1.0]), 0.7)
    jacobian = np.zeros((6, 2))
    jacobian[0, 0] = 1.0
    jacobian[5, 1] = 1.0
    deviations = np.array([1e-3, 2e-3])
    covariance = rest(jacobian, np.diag(deviations**2), rotation).light_covariance(offset)
    samples = np.random.default_rng(1).normal(size=(40_000, 2)) * deviations
    points = np.array(
        [np.array([s, 0, 0]) + rotation_about(np.array([0.0, 0.0, 1.0]), 0.7 + turn) @ offset for s, turn in samples]
    )
    np.testing.assert_allclose(covariance, np.cov(points.T), atol=3e-8)


@pytest.mark.parametrize(
    ("axis", "start", "end"), [("x", "y", "z"), ("y", "z", "x"), ("z", "x", "y")], ids=["x", "y", "z"]
)
def test_rotation_is_right_handed(axis: str, start: str, end: str) -> None:
    unit = dict(zip("xyz", np.eye(3), strict=True))
    np.testing.assert_allclose(rotation_about(unit[axis], np.pi / 2) @ unit[start], unit[end], atol=1e-12)


def test_wrong_sizes_and_infinities_are_refused() -> None:
    with pytest.raises(DataError, match=r"\(6, 3\) does not fit"):
        rest(np.zeros((6, 3)), np.eye(2)).light_covariance(np.zeros(3))
    with pytest.raises(DataError, match="not finite"):
        rest(np.full((6, 2), np.nan), np.eye(2)).light_covariance(np.zeros(3))


def test_an_exposure_before_the_rest_is_refused() -> None:
    at = rest(np.zeros((6, 2)), np.eye(2), since_ns=1_500_000)
    at.require_shown(1_500_000, "p1")
    with pytest.raises(DataError, match=r"pose p1: the image was exposed 0\.0005 s before") as caught:
        at.require_shown(1_000_000, "p1")
    assert caught.value.code == "unusable"
