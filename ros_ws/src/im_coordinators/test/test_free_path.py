"""Free paths: found around what is in the way, the same each time, and true to an independent check."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from im_cell.robot import load_cell, shipped_cells
from im_coordinators.free_path import FreeSpace, find_path
from im_coordinators.path_search import search
from im_coordinators.tool import ANY_TILT
from im_coordinators.upright import Upright
from im_core.errors import ImError
from im_mcs.collision import AllowedContact, CollisionChecker, CollisionScene, Thing
from im_mcs.limits.configuration import load_config
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel

CELL, CONFIG = load_cell(), load_config()
MODEL = CellModel(CELL)
LIMITS = JointLimits(CELL, CONFIG.limits, CONFIG.slots)
CLEARANCE = CONFIG.collision.clearance_m
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
#: Two positions of the left arm with the tool down; the shoulder is on the other side, and on the straight line between
#: them the tool tilts by a right angle.
DOWN = np.array([-0.01, 1.08, 0.56, 1.18, 1.66, -2.94, 2.63, 1.62, -1.13])
DOWN_TOO = np.array([-0.48, 1.68, 0.34, 0.09, 1.59, -2.67, -0.03, -1.715, -1.37])


def space_of(q, index, *things, contacts=()):
    around = CollisionScene(things, tuple(AllowedContact(first=a, second=b, until_ns=0) for a, b in contacts))
    return FreeSpace(MODEL, LIMITS.lower[index], LIMITS.upper[index], CLEARANCE, q, index, around)


def upright_space(start, limit, *things):
    """Of the left arm with the tool as upright as it is at the start."""
    q, index = CELL.home.copy(), np.arange(9)
    q[index] = start
    around, lower, upper = CollisionScene(things, ()), LIMITS.lower[index], LIMITS.upper[index]
    return FreeSpace(MODEL, lower, upper, CLEARANCE, q, index, around, Upright(MODEL, "left_wrist", limit, q))


def lean_of(q):
    """How far the tool of the left arm is from pointing down [rad]."""
    whole = CELL.home.copy()
    whole[:9] = q
    return np.arccos(-MODEL.pose(whole, "left_wrist").rotation[2, 2])


def asked(cell, limits, joints, goal, things=()):
    """The question for a search from home."""
    index = [cell.joint_names.index(joint) for joint in joints]
    q = dict(zip(cell.joint_names, cell.home.tolist(), strict=True))
    lower, upper = limits.lower[index].tolist(), limits.upper[index].tolist()
    return {"joints": joints, "positions": q, "goals": [goal], "lower": lower, "upper": upper, "clearance": CLEARANCE,
            "things": list(things), "contacts": [], "seed": 0, "tilt": ANY_TILT, "wrist": None}  # fmt: skip


def blocked_query(seed, index):
    """Two free positions of some joints with something in between; of both arms the left one stays to the left."""
    random = np.random.default_rng(seed)
    q, draw = CELL.home.copy(), None
    space = space_of(q, index)
    while draw is None or space.line_free(*draw):
        ends = [random.uniform(space.lower, space.upper) for _ in range(2)]
        apart = len(index) == 9 or all(end[0] < end[9] - 0.5 for end in ends)
        draw = ends if apart and all(space.free(end) for end in ends) else draw
    q[index] = draw[0]
    return q, draw[1]


@pytest.mark.parametrize(("seed", "joints"), [(1, 9), (2, 9), (3, 18)])
def test_a_path_around_is_free_at_every_milliradian(seed, joints):
    index = np.arange(joints)
    q, goal = blocked_query(seed, index)
    path = find_path(space_of(q, index), q[index], [goal], seed)
    assert np.array_equal(path.points[-1], goal)
    points = np.vstack([q[index], path.points])
    checker = CollisionChecker(MODEL, CLEARANCE)
    checker.check_path(q, index, points)
    whole = q.copy()
    for a, b in pairwise(points):
        for share in np.linspace(0.0, 1.0, int(np.ceil(np.abs(b - a).max() / 1e-3)) + 1)[:: 1 if joints == 9 else 3]:
            whole[index] = a + share * (b - a)
            assert checker.closest(whole).distance >= CLEARANCE


@pytest.mark.parametrize("limit", [0.05, 0.1, 0.3])
def test_a_tool_that_is_kept_upright_is_so_at_every_milliradian(limit):
    middle = 0.5 * (DOWN + DOWN_TOO)
    assert lean_of(middle) > 1.0
    path = find_path(upright_space(DOWN, limit), DOWN, [DOWN_TOO], 1)
    points = np.vstack([DOWN, path.points])
    assert np.array_equal(points[-1], DOWN_TOO)
    for a, b in pairwise(points):
        shares = np.linspace(0.0, 1.0, int(np.ceil(np.abs(b - a).max() / 1e-3)) + 1)
        assert max(lean_of(a + share * (b - a)) for share in shares) < limit
    q = CELL.home.copy()
    q[:9] = DOWN
    CollisionChecker(MODEL, CLEARANCE).check_path(q, np.arange(9), points)
    again = find_path(upright_space(DOWN, limit), DOWN, [DOWN_TOO], 1)
    assert again.points.tobytes() == path.points.tobytes()


def test_an_upright_tool_goes_around_what_is_in_the_way():
    free = find_path(upright_space(DOWN, 0.3), DOWN, [DOWN_TOO], 1).points
    wrist = _wrist_at(0.5 * (free[0] + free[1]))
    there = Thing.checked("block", "box", (0.06, 0.06, 0.06), "world", [*wrist, *UPRIGHT])
    space = upright_space(DOWN, 0.3, there)
    assert not space.line_free(free[0], free[1])
    points = np.vstack([DOWN, find_path(space, DOWN, [DOWN_TOO], 1).points])
    assert all(upright_space(DOWN, 0.3, there).line_free(a, b) for a, b in pairwise(points))


def test_a_tool_that_leans_at_an_end_is_told_in_degrees():
    leaning = DOWN.copy()
    leaning[7] -= 0.2
    lean = np.degrees(lean_of(leaning))
    for start, goal, end in ((leaning, DOWN, "start"), (DOWN, leaning, "goal")):
        told = f"the tool leans {lean:.1f} degrees from upright at the {end} of the path, and is to keep below 5.6"
        with pytest.raises(ImError, match=told) as raised:
            find_path(upright_space(start, 0.1), start, [goal], 0)
        assert raised.value.code == "limit"
    assert np.array_equal(find_path(upright_space(DOWN, 0.25), DOWN, [leaning], 0).points, [leaning])


def test_of_several_goals_those_that_cannot_be_are_passed_over():
    index, q = np.arange(9), CELL.home.copy()
    near, far = q[index].copy(), q[index].copy()
    near[8] += 0.2
    far[8] += 0.4
    blocked = np.array([1.5, *q[1:9]])
    assert np.array_equal(find_path(space_of(q, index), q[index], [blocked, near, far], 0).points, [near])
    with pytest.raises(ImError, match="the goal of the path is too close"):
        find_path(space_of(q, index), q[index], [blocked], 0)
    leaning = DOWN.copy()
    leaning[7] -= 0.4
    assert np.array_equal(find_path(upright_space(DOWN, 0.3), DOWN, [leaning, DOWN_TOO], 1).points[-1], DOWN_TOO)


def test_a_search_with_several_goals_ends_at_one_of_them():
    index = np.arange(9)
    q, goal = blocked_query(1, index)
    other = goal.copy()
    other[8] *= 0.9
    space = space_of(q, index)
    assert not space.line_free(q[index], other)
    path = find_path(space, q[index], [goal, other], 3)
    assert any(np.array_equal(path.points[-1], each) for each in (goal, other))


def test_the_same_seed_gives_the_same_path_whatever_was_searched_before():
    index = np.arange(9)
    q, goal = blocked_query(1, index)
    first = find_path(space_of(q, index), q[index], [goal], 5).points
    other_q, other_goal = blocked_query(2, index)
    find_path(space_of(other_q, index), other_q[index], [other_goal], 7)
    assert find_path(space_of(q, index), q[index], [goal], 5).points.tobytes() == first.tobytes()


def test_a_thing_in_the_way_is_gone_around_and_one_at_the_goal_is_told():
    """A block where the wrist would pass on its straight way."""
    index = np.arange(9)
    q = CELL.home.copy()
    goal = q[index].copy()
    goal[3] += 1.8
    assert space_of(q, index).line_free(q[index], goal)
    wrist = _wrist_at(q[index] + 0.5 * (goal - q[index]))
    size = (0.1, 0.1, 0.1)
    space = space_of(q, index, Thing.checked("block", "box", size, "world", [*wrist, *UPRIGHT]))
    assert not space.line_free(q[index], goal)
    path = find_path(space, q[index], [goal], 0)
    assert len(path.points) > 1
    there = Thing.checked("block", "box", size, "world", [*_wrist_at(goal), *UPRIGHT])
    with pytest.raises(ImError, match="the goal of the path is too close"):
        find_path(space_of(q, index, there), q[index], [goal], 0)


def test_what_is_held_counts_as_part_of_the_arm():
    index = np.arange(9)
    q = CELL.home.copy()
    assert space_of(q, index).free(q[index])
    held = Thing.checked("bar", "box", (4.0, 0.04, 0.04), "left_wrist", [0.0, 0.0, 0.2, *UPRIGHT])
    assert not space_of(q, index, held).free(q[index]), "so long a bar touches the floor"


def test_what_may_touch_is_no_obstacle_and_all_else_is():
    index = np.arange(9)
    q = CELL.home.copy()
    wrist = Thing.checked("block", "box", (0.05, 0.05, 0.05), "world", [*_wrist_at(q[index]), *UPRIGHT])
    assert not space_of(q, index, wrist).free(q[index])
    assert space_of(q, index, wrist, contacts=[("left_link6", "block"), ("left_link5", "block")]).free(q[index])
    assert not space_of(q, index, wrist, contacts=[("right_link6", "block")]).free(q[index])


def test_a_question_is_answered_and_a_blocked_goal_is_an_error():
    goal = [*CELL.home[:8].tolist(), 0.5]
    question = asked(CELL, LIMITS, CELL.joint_names[:9], goal)
    assert search(CELL, question) == [goal]
    with pytest.raises(ImError, match="the goal of the path"):
        search(CELL, {**question, "goals": [[1.5, *goal[1:]]]})


@pytest.mark.parametrize("name", shipped_cells())
def test_paths_are_found_for_each_group_of_any_cell(name):
    cell = load_cell(name)
    config, model, random = load_config(cell=cell), CellModel(cell), np.random.default_rng(1)
    limits = JointLimits(cell, config.limits, config.slots)
    for group in cell.groups:
        joints = cell.joints_of(group)
        index = np.array([model.index(joint) for joint in joints])
        space, goal = FreeSpace(model, limits.lower[index], limits.upper[index], CLEARANCE, cell.home, index), None
        while goal is None or not space.free(goal):
            goal = np.clip(cell.home[index] + random.uniform(-0.5, 0.5, len(index)), space.lower, space.upper)
        points = search(cell, asked(cell, limits, joints, goal.tolist()))
        assert points[-1] == goal.tolist()
        CollisionChecker(model, CLEARANCE).check_path(cell.home, index, np.array([cell.home[index], *points]))


def _wrist_at(q):
    data = MODEL.pin.createData()
    whole = CELL.home.copy()
    whole[:9] = q
    pin.framesForwardKinematics(MODEL.pin, data, whole)
    return data.oMf[MODEL.frame_id("left_wrist")].act(np.array([0.0, 0.0, 0.1]))


def test_arms_that_the_watch_has_stopped_close_to_each_other_part_and_come_no_closer():
    index = np.array([CELL.joint_names.index("left_track")])
    checker = CollisionChecker(MODEL, CLEARANCE)
    q = CELL.home.copy()
    q[CELL.joint_names.index("right_track")] = 0.5
    free, near = float(q[index[0]]), 0.5
    for _ in range(40):
        q[index] = middle = 0.5 * (free + near)
        free, near = (middle, near) if checker.closest(q).distance > 0.6 * CLEARANCE else (free, middle)
    start, away = q[index].copy(), CELL.home[index]
    assert 0.0 < checker.closest(q).distance < CLEARANCE
    path = find_path(space_of(q, index), start, [away], seed=1)
    assert checker.check_path(q, index, np.vstack([start, path.points])) > 0.5 * CLEARANCE
    for goal in (start + 0.003, start + 0.3):
        with pytest.raises(ImError, match="goal of the path is too close"):
            find_path(space_of(q, index), start, [goal], seed=1)
        with pytest.raises(ImError, match="is the least allowed"):
            checker.check_path(q, index, np.vstack([start, goal]))
    q[index] = start + 0.1
    assert checker.closest(q).distance < 0.0
    with pytest.raises(ImError, match="at the start"):
        checker.check_path(q, index, np.vstack([q[index], away]))
    with pytest.raises(ImError, match="start of the path is too close"):
        find_path(space_of(q, index), q[index], [away], seed=1)
