"""The scanner's formulas against two mirrors that reflect a ray."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from im_cell.laser_model import LaserModel
from im_core.errors import DataError

ANGLE = st.floats(-0.3, 0.3)
TURN = Rotation.from_rotvec([0.4, -2.1, 0.3]).as_matrix()
PLACE = np.array([0.3, -0.2, 4.1])


def model(**changed):
    values = {"gap": 0.012, "gain": (1.01, 0.985), "offset": 0.004, **changed}
    return LaserModel(TURN, PLACE, **values)


def reflected(first, second, gap):
    """A ray along x, thrown by a mirror about z at (0, -gap, 0), then by one about x at the origin."""
    ray, start = np.array([1.0, 0.0, 0.0]), np.array([-1.0, -gap, 0.0])
    for axis, rest, angle, middle in (
        ([0, 0, -1.0], np.array([-1.0, 1.0, 0.0]), first, np.array([0.0, -gap, 0.0])),
        ([-1.0, 0, 0], np.array([0.0, -1.0, 1.0]), second, np.zeros(3)),
    ):
        normal = Rotation.from_rotvec(np.multiply(axis, angle)).apply(rest / np.sqrt(2.0))
        start = start + ray * (normal @ (middle - start)) / (normal @ ray)
        ray = ray - 2.0 * (normal @ ray) * normal
    return start, ray


@given(ANGLE, ANGLE)
def test_rays_are_those_of_two_reflections(first, second):
    laser = model()
    start, way = laser.rays([first, second])
    true_first, true_second = 1.01 * first + 0.004, 0.985 * second
    there, along = reflected(true_first, true_second, 0.012)
    np.testing.assert_allclose(way, TURN @ along, atol=1e-12)
    np.testing.assert_allclose(start, TURN @ there + PLACE, atol=1e-12)


@given(ANGLE, ANGLE, st.floats(0.1, 9.0))
def test_angles_to_a_point_are_those_of_the_ray_that_meets_it(first, second, distance):
    laser = model()
    start, way = laser.rays([first, second])
    np.testing.assert_allclose(laser.angles_to(start + distance * way), [first, second], atol=1e-10)


@given(ANGLE, ANGLE, st.floats(0.1, 9.0))
def test_a_sweep_of_mirror_1_stays_in_its_plane(first, second, distance):
    laser = model()
    start, way = laser.rays([first, second])
    assert abs((start + distance * way - laser.position) @ laser.planes(second)) < 1e-12


def test_many_at_once_are_the_same_as_one_by_one():
    laser, angles = model(), np.random.default_rng(1).uniform(-0.2, 0.2, (7, 2))
    starts, ways = laser.rays(angles)
    for pair, start, way in zip(angles, starts, ways, strict=True):
        np.testing.assert_allclose(np.array(laser.rays(pair)), [start, way], atol=1e-14)


def test_targets_out_of_reach():
    laser = LaserModel(np.eye(3), np.zeros(3), 0.01)
    with pytest.raises(DataError, match=r"the target is behind the laser scanner, by 0\.500 m"):
        laser.angles_to([0.1, 0.2, -0.5])
    with pytest.raises(DataError, match="not finite"):
        laser.angles_to([0.1, np.nan, 1.0])
