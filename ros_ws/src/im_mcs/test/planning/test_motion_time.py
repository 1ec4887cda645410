"""The time of a straight motion in closed form, beside the trajectories of MCS."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_cell.motion_time import motion_times
from im_cell.robot import load_cell
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.motions.joint import JointPath

CELL = load_cell()
JOINTS = CELL.joints_of("left")
LIMITS = MotionLimits(*(
    np.array([getattr(joint.limits, kind) for name in JOINTS for joint in CELL.joints if joint.name == name])
    for kind in ("velocity", "acceleration", "jerk")
))  # fmt: skip


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=len(JOINTS), max_size=len(JOINTS)).filter(
        lambda way: max(map(abs, way)) > 1e-3
    ),
    st.sampled_from([1e-3, 1e-2, 0.1, 0.5, 2.0]),
)
def test_the_time_of_a_motion_is_that_of_its_trajectory(way: list[float], scale: float) -> None:
    end = scale * np.array(way)
    trajectory = JointPath(np.zeros(len(JOINTS)), end[None], LIMITS)
    assert float(motion_times(CELL, JOINTS, end)) == pytest.approx(trajectory.duration, rel=1e-6, abs=1e-6)


def test_no_motion_takes_no_time_and_many_are_told_at_once() -> None:
    ways = np.zeros((2, 3, len(JOINTS)))
    ways[1, 2, 0] = 0.4
    times = motion_times(CELL, JOINTS, ways)
    assert times.shape == (2, 3)
    assert np.flatnonzero(times).tolist() == [5]
