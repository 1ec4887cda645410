"""Inverse kinematics in closed form, next to the iteration and to pinocchio."""

import numpy as np
import pinocchio as pin
import pytest

from im_cell.robot import load_cell, shipped_cells
from im_core.errors import DataError
from im_mcs.collision import CollisionChecker
from im_mcs.inverse import InverseKinematics
from im_mcs.inverse.closed_form import ClosedForm
from im_mcs.limits.configuration import load_config
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel

#: Arms by cell, and whether the wrist is spherical; of the other shipped cells none has six joints.
ARMS = {"puma_pair": True, "ur5": False, "ur_pair": False}


EACH = [(name, group) for name in ARMS for group in load_cell(name).groups]


@pytest.fixture(scope="module", params=EACH, ids="-".join)
def arm(request):
    """Model, limits, joints and tip of an arm without its carriers."""
    cell = load_cell(request.param[0])
    group, model, config = request.param[1], CellModel(cell), load_config(cell=cell)
    joints = np.array([model.index(joint) for joint in cell.arm_of(group)])
    return model, JointLimits(cell, config.limits, config.slots), joints, cell.groups[group].tip


def drawn(arm, count, seed):
    """Positions of all joints, those of the arm at random."""
    model, limits, joints, _ = arm
    random = np.random.default_rng(seed)
    for _ in range(count):
        q = model.cell.home.copy()
        q[joints] = random.uniform(limits.lower[joints] + 0.03, limits.upper[joints] - 0.03)
        yield q


def turned(a, b):
    """How far positions are apart, full turns left out [rad]."""
    return np.abs(np.remainder(np.asarray(a) - b + np.pi, 2.0 * np.pi) - np.pi).max()


def off(model, q, tip, pose):
    return np.abs(pin.log6(pose.actInv(model.pose(q, tip))).vector).max()


@pytest.mark.parametrize("name", shipped_cells())
def test_the_build_of_an_arm_is_recognised(name):
    model = CellModel(cell := load_cell(name))
    for each, group in cell.groups.items():
        joints = [model.index(joint) for joint in cell.arm_of(each)]
        closed = ClosedForm.of(model, group.tip, np.array(joints))
        assert (None if closed is None else closed.spherical) == ARMS.get(name)


def test_all_solutions_meet_the_pose_and_the_one_that_made_it_is_among_them(arm):
    model, _, joints, tip = arm
    closed, counts = ClosedForm.of(model, tip, joints), set()
    for q in drawn(arm, 60, 1):
        pose, here = model.pose(q, tip), model.cell.home
        found = list(closed.solve(model, pose, here, joints))
        counts.add(len(found))
        assert min(turned(each, q[joints]) for each in found) < 1e-6
        for each in found:
            whole = here.copy()
            whole[joints] = each
            assert off(model, whole, tip, pose) < 1e-7
    assert max(counts) == 8


def test_the_iteration_finds_no_other_solution(arm):
    model, limits, joints, tip = arm
    solver, closed, ends = InverseKinematics(model, limits, joints, tip), ClosedForm.of(model, tip, joints), 0
    poses, starts = list(drawn(arm, 8, 2)), list(drawn(arm, 8, 3))
    for q in poses:
        pose = model.pose(q, tip)
        known = list(closed.solve(model, pose, model.cell.home, joints))
        for start in starts:
            *_, end = solver.descent(pose, model.cell.home, start[joints])
            if end.reached:
                ends += 1
                assert min(turned(end.q, each) for each in known) < 1e-4
    assert ends > 10


def test_the_nearest_solution_within_limits_is_taken(arm):
    model, limits, joints, tip = arm
    solver = InverseKinematics(model, limits, joints, tip)
    for q in drawn(arm, 40, 4):
        pose = model.pose(q, tip)
        np.testing.assert_allclose(solver.solve(pose, model.cell.home, q[joints]), q[joints], atol=1e-6)
        found = solver.solve(pose, model.cell.home, model.cell.home[joints])
        assert (found >= limits.lower[joints]).all()
        assert (found <= limits.upper[joints]).all()
        others = [each.q for each in solver.attempts(pose, model.cell.home, [model.cell.home[joints]])]
        ways = [np.linalg.norm(each - model.cell.home[joints]) for each in others]
        assert ways == sorted(ways)
        np.testing.assert_array_equal(found, others[0])


@pytest.mark.parametrize("straight", [2, 4])
def test_a_singular_pose_is_met_and_the_free_joint_stays(arm, straight):
    """The wrist, or the elbow of a UR, stretched out: two solutions are one, or there is a whole line of them."""
    model, limits, joints, tip = arm
    solver = InverseKinematics(model, limits, joints, tip)
    for q in drawn(arm, 20, 5):
        q[joints[straight]] = 0.0
        pose = model.pose(q, tip)
        whole = model.cell.home.copy()
        whole[joints] = solver.solve(pose, model.cell.home, q[joints])
        assert off(model, whole, tip, pose) < 1e-6
        if straight == 4:
            assert turned(whole[joints], q[joints]) < 1e-3


@pytest.mark.parametrize("arm", [("ur5", "arm")], indirect=True)
def test_a_solution_in_collision_is_passed_over_for_the_next(arm):
    model, limits, joints, tip = arm
    solver, checker = InverseKinematics(model, limits, joints, tip), CollisionChecker(model, 0.01)
    passed = 0
    for q in drawn(arm, 60, 6):
        pose = model.pose(q, tip)
        free = []
        for attempt in solver.attempts(pose, model.cell.home, [model.cell.home[joints]]):
            whole = model.cell.home.copy()
            whole[joints] = attempt.q
            free.append(checker.closest(whole).distance >= 0.01)
        if True in free[1:] and not free[0]:
            passed += 1
            whole = model.cell.home.copy()
            whole[joints] = solver.solve(pose, model.cell.home, model.cell.home[joints], checker)
            assert off(model, whole, tip, pose) < 1e-6
            checker.require_free(whole)
    assert passed > 0


def test_what_is_out_of_reach_is_said_with_the_nearest_place(arm):
    model, limits, joints, tip = arm
    solver = InverseKinematics(model, limits, joints, tip)
    pose = model.pose(model.cell.home, tip).copy()
    pose.translation += np.array([0.0, 0.0, 5.0])
    with pytest.raises(DataError, match=f"{tip} at .* is out of reach: the nearest solution is at .* mm and"):
        solver.solve(pose, model.cell.home, model.cell.home[joints])


def arm_of(places, axes):
    """A model of six joints, each with its place on the one before and its axis."""
    model, joint = pin.Model(), 0
    for number, (place, axis) in enumerate(zip(places, axes, strict=True)):
        joint = model.addJoint(joint, pin.JointModelRevoluteUnaligned(np.array(axis, dtype=float)), place, f"j{number}")
    model.addFrame(pin.Frame("tip", joint, 0, pin.SE3(np.eye(3), np.array([0.0, 0.02, 0.1])), pin.FrameType.OP_FRAME))

    class Bare(CellModel):
        def __init__(self):
            self.pin, self.n, self._data = model, 6, model.createData()

    return Bare()


def place(x, y, z, rpy=(0.0, 0.0, 0.0)):
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array([x, y, z]))


# the axes 2 and 3 upright as of a SCARA; a first axis that leans, with offsets to all sides; right angles as 1.5708
SLANTED = [place(0.1, 0.0, 0.2), place(0.05, 0.1, 0.3), place(0.0, -0.03, 0.45), place(0.02, 0.05, 0.3),
           place(0.0, 0.0, 0.1), place(0.0, 0.0, 0.0)]  # fmt: skip
ROUNDED = [place(0.0, 0.0, 0.1625), place(0.0, 0.0, 0.0, (1.5708, 0.0, 0.0)), place(-0.425, 0.0, 0.0),
           place(-0.3922, 0.0, 0.1333), place(0.0, -0.0997, 0.0, (1.5708, 0.0, 0.0)),
           place(0.0, 0.0996, 0.0, (-1.5708, 0.0, 0.0))]  # fmt: skip


@pytest.mark.parametrize(
    ("places", "axes", "spherical"),
    [
        (SLANTED, [[0, 0.6, 0.8], [0, 1, 0], [0, 1, 0], [0, 0, 1], [0, 1, 0], [0.6, 0, 0.8]], True),
        (ROUNDED, [[0, 0, 1]] * 6, False),
    ],
)
def test_an_arm_of_another_maker_is_solved(places, axes, spherical):
    model, random = arm_of(places, axes), np.random.default_rng(7)
    closed, joints = ClosedForm.of(model, "tip", np.arange(6)), np.arange(6)
    assert closed.spherical == spherical
    for q in random.uniform(-3.0, 3.0, (40, 6)):
        pose = model.pose(q, "tip")
        found = list(closed.solve(model, pose, np.zeros(6), joints))
        assert min(turned(each, q) for each in found) < 1e-3
        assert max(off(model, each, "tip", pose) for each in found) < 1e-4


@pytest.mark.parametrize(("moved", "kept"), [((1e-3, 0.0, 0.0), False), ((0.0, 1e-3, 1e-3), True)])
def test_an_arm_whose_axes_pass_each_other_is_left_to_the_iteration(moved, kept):
    """As after a calibration: a UR whose last axis is a millimetre beside the one before."""
    places = [*ROUNDED[:5], ROUNDED[5] * place(*moved)]
    found = ClosedForm.of(arm_of(places, [[0, 0, 1]] * 6), "tip", np.arange(6))
    assert (found is not None) == kept


def test_an_arm_with_a_joint_that_slides_is_left_to_the_iteration():
    model = arm_of(SLANTED, [[0, 0, 1], [0, 1, 0], [0, 1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1]])
    assert ClosedForm.of(model, "tip", np.arange(6)) is not None
    slides, joint = pin.Model(), 0
    for rank, where in enumerate(SLANTED):
        kind = pin.JointModelPY() if rank == 1 else pin.JointModelRY() if rank in (2, 4) else pin.JointModelRZ()
        joint = slides.addJoint(joint, kind, where, f"j{rank}")
    slides.addFrame(pin.Frame("tip", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    model.pin = slides
    assert ClosedForm.of(model, "tip", np.arange(6)) is None


def test_an_arm_of_five_joints_meets_a_pose_but_for_a_small_turn_about_one_axis():
    cell = load_cell("so101")
    model, config, joints = CellModel(cell), load_config(cell=cell), np.arange(5)
    limits, tip = JointLimits(cell, config.limits, config.slots), cell.groups["arm"].tip
    solver, random = InverseKinematics(model, limits, joints, tip), np.random.default_rng(8)
    for _ in range(6):
        q = random.uniform(limits.lower + 0.1, limits.upper - 0.1)
        pose = model.pose(q, tip).copy()
        axis = random.normal(size=3)
        pose.rotation = pin.exp3(0.01 * axis / np.linalg.norm(axis)) @ pose.rotation
        *_, end = solver.descent(pose, cell.home, q)
        assert end.reached
        off_pose = pose.actInv(model.pose(end.q, tip))
        assert np.linalg.norm(off_pose.translation) < 1e-6
        assert np.linalg.norm(pin.log3(off_pose.rotation)) < 0.0175
        pose.rotation = pin.exp3(0.3 * axis / np.linalg.norm(axis)) @ pose.rotation
        *_, end = solver.descent(pose, cell.home, q)
        assert end.reached == (np.linalg.norm(pin.log3(pose.rotation @ model.pose(end.q, tip).rotation.T)) < 0.0175)


@pytest.mark.parametrize("name", ["so101", "panda", "puma_pair"])
def test_a_place_beyond_the_stretched_chain_is_known_without_a_search(name, monkeypatch):
    """No position of the joints is beyond; of a place that is, a few starts tell where the nearest solution is."""
    cell = load_cell(name)
    model, group = CellModel(cell), next(iter(cell.groups))
    tip, index = cell.groups[group].tip, np.array([cell.joint_names.index(j) for j in cell.joints_of(group)])
    limits = JointLimits(cell, load_config(cell=cell).limits)
    solver, random = InverseKinematics(model, limits, index, tip), np.random.default_rng(3)
    for _ in range(50):
        q = cell.home.copy()
        q[index] = random.uniform(limits.lower[index], limits.upper[index])
        assert not solver._is_beyond(model.pose(q, tip), cell.home)
    begun, descent = [], solver.descent
    monkeypatch.setattr(solver, "descent", lambda *given, **more: begun.append(given) or descent(*given, **more))
    far = model.pose(cell.home, tip)
    far.translation = far.translation + np.array([9.0, 0.0, 0.0])
    with pytest.raises(DataError, match="out of reach: the nearest solution is at"):
        solver.solve(far, cell.home, cell.home[index])
    assert len(begun) == 8


def test_a_start_that_leads_nowhere_ends_early():
    """An arm of five joints cannot yaw its tip in its place: its first joint alone yaws."""
    cell = load_cell("so101")
    model, index, tip = CellModel(cell), np.arange(5), cell.groups["arm"].tip
    solver = InverseKinematics(model, JointLimits(cell, load_config(cell=cell).limits), index, tip)
    wanted = model.pose(cell.home, tip)
    wanted.rotation = pin.exp3(np.array([0.0, 0.0, 1.2])) @ wanted.rotation
    lengths = []
    for start in solver._starts(cell.home[index])[:8]:
        *way, end = solver.descent(wanted, cell.home, start, patient=False)
        assert not end.reached
        lengths.append(len(way) + 1)
    assert np.mean(lengths) < 70.0, "of 100"
