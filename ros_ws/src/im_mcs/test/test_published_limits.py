"""What ``/robot_description`` says of limits is what is enforced; home is a good place to start from."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from im_cell.robot import robot_description
from im_core.errors import LimitError
from im_mcs.inverse.arm import Arm
from im_mcs.limits.limits import JointLimits
from im_mcs.planning.motions.joint import JointPath


@pytest.fixture(scope="module")
def limits(cell, config):
    return JointLimits(cell, config.limits, config.slots)


@pytest.fixture(scope="module")
def published(cell, limits):
    """Lower, upper, velocity and effort of each joint, as a planner reads them, shape (18, 4)."""
    tree = ET.fromstring(robot_description(cell, limits.enforced()))
    told = {
        joint.get("name"): joint.find("limit").attrib
        for joint in tree.findall("joint")
        if joint.find("limit") is not None
    }
    return np.array(
        [[float(told[name][key]) for key in ("lower", "upper", "velocity", "effort")] for name in cell.joint_names]
    )


def test_ranges(limits, published):
    for k in range(18):
        index = np.array([k])
        for value in published[k, :2]:
            limits.check_positions(index, [value], "there")
        for value in (published[k, 0] - 1e-9, published[k, 1] + 1e-9):
            with pytest.raises(LimitError):
                limits.check_positions(index, [value], "there")


def test_velocities_are_those_of_the_fastest_motion(limits, published):
    """A way long enough for each joint to come to its full speed."""
    for k in range(18):
        start, end = np.array([-50.0]), np.array([50.0])
        path = JointPath(start, end[None, :], limits.motion.of(np.array([k])))
        fastest = np.abs(path.span(np.linspace(0.0, path.duration, 2001)).v).max()
        assert fastest == pytest.approx(published[k, 2], rel=1e-6)


def test_torques(limits, published):
    np.testing.assert_array_equal(published[:, 3], limits.torque)


@pytest.mark.parametrize("side", ["left", "right"])
def test_home_is_no_singularity(cell, model, side):
    """Shoulder, elbow and wrist: a factor of 0 would be a singularity."""
    assert min(np.abs(Arm(model, f"{side}_wrist").factors(cell.home))) > 0.2
