"""An arm without a spherical wrist: the UR5e, by its maker's Denavit-Hartenberg parameters."""

from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from im_core.errors import ImError
from im_mcs.inverse import Arm, ArmTracker, InverseKinematics
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.model import CellModel
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.line.line import LinePreparation
from im_mcs.planning.trajectories.trajectory import Setpoint
from im_mcs.protocol.requests import LineMove

A = (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
D = (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)
ALPHA = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
NAMES = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
HOME = np.array([0.0, -1.5, 1.6, -1.7, -1.5, 0.0])
FRAME = "tool0"


def link(a, d, alpha):
    """From the frame behind a joint to that of the next one: along z and x, then about x."""
    return pin.SE3(pin.utils.rotate("x", alpha), np.array([a, 0.0, d]))


class AnotherModel(CellModel):
    """Kinematics of one arm that stands alone."""

    def __init__(self):
        self.pin, place, joint = pin.Model(), pin.SE3.Identity(), 0
        for name, a, d, alpha in zip(NAMES, A, D, ALPHA, strict=True):
            joint = self.pin.addJoint(joint, pin.JointModelRZ(), place, name)
            place = link(a, d, alpha)
        self.pin.addFrame(pin.Frame(FRAME, joint, 0, place, pin.FrameType.OP_FRAME))
        self.names, self.n = NAMES, len(NAMES)
        self.cell = SimpleNamespace(home=HOME, joints=[SimpleNamespace(kind="revolute")] * len(NAMES))
        self._data = self.pin.createData()


@pytest.fixture(scope="module")
def other():
    return AnotherModel()


@pytest.fixture(scope="module")
def ranges():
    """Limits as :class:`im_mcs.limits.limits.JointLimits` has them."""
    wide = 2.0 * np.pi * np.ones(6)
    wide[2] = np.pi
    motion = MotionLimits(np.full(6, 3.14), np.full(6, 14.0), np.full(6, 140.0))
    return SimpleNamespace(names=NAMES, units=("rad",) * 6, lower=-wide, upper=wide, motion=motion)


def positions(ranges, count, share=1.0):
    return np.random.default_rng(0).uniform(share * ranges.lower, share * ranges.upper, (count, 6))


def test_poses_that_it_reaches_are_found(other, ranges):
    solver = InverseKinematics(other, ranges, np.arange(6), FRAME)
    for q in positions(ranges, 60):
        pose = other.pose(q, FRAME)
        found = other.pose(solver.solve(pose, HOME, HOME), FRAME)
        assert pin.log6(found.actInv(pose)).np == pytest.approx(0.0, abs=1e-6)


def test_no_pose_that_it_reaches_is_beyond_its_reach(other, ranges):
    arm = Arm(other, FRAME)
    assert arm.singularities == ("arm",)
    places = [other.pose(q, FRAME).translation for q in positions(ranges, 2000)]
    assert max(arm.beyond_reach(HOME, place) for place in places) == 0.0
    assert arm.beyond_reach(HOME, np.array([2.0, 0.0, 0.0])) > 0.5


def line(other, ranges, config, q, way):
    """Prepare a line of the tool from positions along a way [m]; the pose that is asked for, and where it ends."""
    begin = other.pose(q, FRAME)
    target = pin.SE3(begin.rotation, begin.translation + way)
    context = PlanContext(other, ranges, np.arange(6), (FRAME,), lambda: q, 0.009, config)
    preparation = LinePreparation(
        context, LineMove(poses=[pin.SE3ToXYZQUAT(target).tolist()]), lambda: Setpoint.at_rest(q)
    )
    while (motion := preparation.step()) is None:
        pass
    return target, other.pose(motion.end_setpoint.q, FRAME)


def test_lines_far_from_singularities_are_followed(other, ranges, config):
    tracker, random = ArmTracker(other, Arm(other, FRAME), FRAME), np.random.default_rng(3)
    far = [q for q in positions(ranges, 400, 0.9) if tracker.singular_value(q) > 0.1][:20]
    assert len(far) == 20
    for q in far:
        way = random.standard_normal(3)
        target, end = line(other, ranges, config, q, 0.02 * way / np.linalg.norm(way))
        assert pin.log6(end.actInv(target)).np == pytest.approx(0.0, abs=1e-5)


def test_a_line_into_a_singularity_is_refused_by_its_singular_value(other, ranges, config):
    stretched = np.array([0.0, -1.0, 0.3, -1.0, -1.5, 0.0])
    outwards = other.pose(np.array([0.0, -1.0, 0.0, -1.0, -1.5, 0.0]), FRAME).translation
    outwards -= other.pose(stretched, FRAME).translation
    with pytest.raises(ImError, match=r"arm singularity .*; 0\.02 is the least allowed") as refused:
        line(other, ranges, config, stretched, 3.0 * outwards)
    assert refused.value.code == "singular"
