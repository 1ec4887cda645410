"""Free paths: found around what is in the way, the same each time, and true to an independent check."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from im_cell.robot import FreeBody, load_cell, shipped_cells
from im_coordinators.free_path import FreeSpace, find_path
from im_coordinators.path_search import search
from im_core.errors import ImError
from im_mcs.collision import CollisionChecker, Thing
from im_mcs.limits.configuration import load_config
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel

CELL, CONFIG = load_cell(), load_config()
MODEL = CellModel(CELL)
LIMITS = JointLimits(CELL, CONFIG.limits, CONFIG.slots)
CLEARANCE = CONFIG.collision.clearance_m
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def space_of(q, index, things=()):
    return FreeSpace(MODEL, LIMITS, CLEARANCE, q, index, things)


def blocked_query(seed, index, things=()):
    """Two free positions of some joints with something in between; of both arms the left one stays to the left."""
    random = np.random.default_rng(seed)
    q, draw = CELL.home.copy(), None
    space = space_of(q, index, things)
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
    path = find_path(space_of(q, index), q[index], goal, seed)
    assert np.array_equal(path.points[-1], goal)
    points = np.vstack([q[index], path.points])
    checker = CollisionChecker(MODEL, CLEARANCE)
    checker.check_path(q, index, points)
    whole = q.copy()
    for a, b in pairwise(points):
        for share in np.linspace(0.0, 1.0, int(np.ceil(np.abs(b - a).max() / 1e-3)) + 1)[:: 1 if joints == 9 else 3]:
            whole[index] = a + share * (b - a)
            assert checker.closest(whole).distance >= CLEARANCE


def test_the_same_seed_gives_the_same_path_whatever_was_searched_before():
    index = np.arange(9)
    q, goal = blocked_query(1, index)
    first = find_path(space_of(q, index), q[index], goal, 5).points
    other_q, other_goal = blocked_query(2, index)
    find_path(space_of(other_q, index), other_q[index], other_goal, 7)
    assert find_path(space_of(q, index), q[index], goal, 5).points.tobytes() == first.tobytes()


def test_a_thing_in_the_way_is_gone_around_and_one_at_the_goal_is_told():
    """A block where the wrist would pass on its straight way."""
    index = np.arange(9)
    q = CELL.home.copy()
    goal = q[index].copy()
    goal[3] += 1.8
    assert space_of(q, index).line_free(q[index], goal)
    wrist = _wrist_at(q[index] + 0.5 * (goal - q[index]))
    block = FreeBody(name="block", kind="box", size=(0.1, 0.1, 0.1), mass=1.0, color=(0, 0, 0), position=(0, 0, 1))
    things = [Thing(block, "world", np.array([*wrist, *UPRIGHT]))]
    space = space_of(q, index, things)
    assert not space.line_free(q[index], goal)
    path = find_path(space, q[index], goal, 0)
    assert len(path.points) > 1
    with pytest.raises(ImError, match="the goal of the path is too close"):
        find_path(
            space_of(q, index, [Thing(block, "world", np.array([*_wrist_at(goal), *UPRIGHT]))]), q[index], goal, 0
        )


def test_what_is_held_counts_as_part_of_the_arm():
    index = np.arange(9)
    q = CELL.home.copy()
    bar = FreeBody(name="bar", kind="box", size=(4.0, 0.04, 0.04), mass=1.0, color=(0, 0, 0), position=(0, 0, 1))
    assert space_of(q, index).free(q[index])
    held = Thing(bar, "left_wrist", np.array([0.0, 0.0, 0.2, *UPRIGHT]))
    assert not space_of(q, index, [held]).free(q[index]), "so long a bar touches the floor"


def test_a_question_is_answered_and_a_blocked_goal_is_an_error():
    q = dict(zip(CELL.joint_names, CELL.home.tolist(), strict=True))
    joints = CELL.joint_names[:9]
    goal = [*CELL.home[:8].tolist(), 0.5]
    question = {"joints": joints, "positions": q, "goal": goal, "things": [], "seed": 0}
    assert search(CELL, question) == [goal]
    with pytest.raises(ImError, match="the goal of the path"):
        search(CELL, {**question, "goal": [1.5, *goal[1:]]})


@pytest.mark.parametrize("name", shipped_cells())
def test_paths_are_found_for_each_group_of_any_cell(name):
    cell = load_cell(name)
    config, model, random = load_config(cell=cell), CellModel(cell), np.random.default_rng(1)
    limits = JointLimits(cell, config.limits, config.slots)
    for group in cell.groups:
        joints = cell.joints_of(group)
        index = np.array([model.index(joint) for joint in joints])
        space, goal = FreeSpace(model, limits, CLEARANCE, cell.home, index), None
        while goal is None or not space.free(goal):
            goal = np.clip(cell.home[index] + random.uniform(-0.5, 0.5, len(index)), space.lower, space.upper)
        q = dict(zip(cell.joint_names, cell.home.tolist(), strict=True))
        points = search(cell, {"joints": joints, "positions": q, "goal": goal.tolist(), "things": [], "seed": 0})
        assert points[-1] == goal.tolist()
        CollisionChecker(model, CLEARANCE).check_path(cell.home, index, np.array([cell.home[index], *points]))


def _wrist_at(q):
    data = MODEL.pin.createData()
    whole = CELL.home.copy()
    whole[:9] = q
    pin.framesForwardKinematics(MODEL.pin, data, whole)
    return data.oMf[MODEL.frame_id("left_wrist")].act(np.array([0.0, 0.0, 0.1]))
