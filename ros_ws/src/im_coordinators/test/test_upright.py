"""Tilt of a tool: what it is, how fast joints can change it, and positions without it."""

import numpy as np
import pytest

from im_cell.robot import load_cell
from im_coordinators.upright import EXACT_RAD, MARGIN_RAD, Upright
from im_mcs.limits.configuration import load_config
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel

CELL, CONFIG = load_cell(), load_config()
MODEL = CellModel(CELL)
LIMITS = JointLimits(CELL, CONFIG.limits, CONFIG.slots)
LEFT = np.arange(9)
WRIST = "left_wrist"


def drawn(seed, count):
    """Positions of all joints within their limits."""
    random = np.random.default_rng(seed)
    return random.uniform(LIMITS.lower, LIMITS.upper, (count, MODEL.n))


def test_it_is_the_angle_of_the_axis_nearest_to_the_vertical_at_the_start_and_of_no_other_later():
    for start, later in zip(drawn(1, 50), drawn(2, 50), strict=True):
        vertical = MODEL.pose(start, WRIST).rotation.T @ [0.0, 0.0, 1.0]
        axis = max((sign * unit for unit in np.eye(3) for sign in (1.0, -1.0)), key=lambda each: each @ vertical)
        upright = Upright(MODEL, WRIST, 0.3, start)
        for q in (start, later):
            angle = np.arccos((MODEL.pose(q, WRIST).rotation @ axis)[2])
            assert upright.tilt(q) == pytest.approx(angle, abs=1e-7)


def test_no_motion_changes_it_by_more_than_its_levers_say():
    upright = Upright(MODEL, WRIST, 0.3, CELL.home)
    for a, b in zip(drawn(3, 300), drawn(4, 300), strict=True):
        for share in (1.0, 1e-3):
            there = a + share * (b - a)
            assert abs(upright.tilt(there) - upright.tilt(a)) <= upright.levers() @ np.abs(there - a) + 1e-9
    arm = {name for name, lever in zip(MODEL.names, upright.levers(), strict=True) if lever}
    assert arm == {f"left_{joint}" for joint in ("rotation", "tilt", "j1", "j2", "j3", "j4", "j5", "j6")}


def test_a_projection_has_none_is_within_the_limits_and_moves_no_other_joint():
    lower, upper = LIMITS.lower[LEFT], LIMITS.upper[LEFT]
    upright = Upright(MODEL, WRIST, 0.3, CELL.home)
    found = 0
    for q in drawn(5, 100):
        near = upright.project(q, LEFT, lower, upper)
        if near is None:
            continue
        found += 1
        assert ((lower <= near) & (near <= upper)).all()
        assert upright.tilt(np.append(near, q[9:])) < EXACT_RAD
        again = upright.project(np.append(near, q[9:]), LEFT, lower, upper)
        assert np.array_equal(again, near), "it is where it should be"
    assert found > 80


def test_where_no_position_is_upright_there_is_no_projection():
    q = CELL.home.copy()
    upright = Upright(MODEL, WRIST, 0.3, q)
    assert upright.tilt(q) > EXACT_RAD
    assert upright.project(q, LEFT, q[LEFT] - 1e-3, q[LEFT] + 1e-3) is None


def test_the_limit_of_a_path_leaves_room_for_the_error_of_following_it():
    assert Upright(MODEL, WRIST, 0.3, CELL.home).limit == pytest.approx(0.3 - MARGIN_RAD)
