"""Limits of setpoints: what may be followed passes unchanged, nothing else gets through."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruckig import ControlInterface, InputParameter, Result, Ruckig, Trajectory

from im_cell.robot import load_cell, shipped_cells
from im_core.errors import DataError
from im_mcs.limits.configuration import load_config
from im_mcs.limits.limits import JointLimits
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.limits.saturation import KINDS, Saturations
from im_mcs.safety import SetpointLimiter
from im_mcs.safety.stopping_position import Reach, stopping_position

DT = 0.0045
JERK_FACTOR = 2.0


@pytest.fixture(params=shipped_cells())
def cell(request):
    return load_cell(request.param)


@pytest.fixture
def limits(cell):
    config = load_config(cell=cell)
    return JointLimits(cell, config.limits, config.slots)


@pytest.fixture
def limiter(limits):
    counts = Saturations(len(limits.lower))
    made = SetpointLimiter(limits, DT, 2 * DT, JERK_FACTOR, counts)
    made.counts = counts.counts
    return made


def at_rest(q):
    return np.array([q, np.zeros_like(q), np.zeros_like(q)])


@settings(max_examples=200, deadline=None)
@given(
    v=st.floats(-2.0, 2.0),
    a=st.floats(-5.0, 5.0),
    most_a=st.floats(5.0, 8.0),
    jerk=st.floats(20.0, 200.0),
)
def test_the_stopping_position_is_that_of_ruckig_s_fastest_stop(v, a, most_a, jerk):
    limits = MotionLimits(np.array([2.0]), np.array([most_a]), np.array([jerk]))
    request = InputParameter(1)
    request.control_interface = ControlInterface.Velocity
    request.current_velocity, request.current_acceleration = [v], [a]
    request.max_acceleration, request.max_jerk = [most_a], [jerk]
    trajectory = Trajectory(1)
    assert Ruckig(1).calculate(request, trajectory) in (Result.Working, Result.Finished)
    expected = trajectory.at_time(trajectory.duration)[0][0]
    found = stopping_position(np.zeros(1), np.array([v]), np.array([a]), limits)[0]
    assert found == pytest.approx(expected, abs=1e-6)
    assert abs(found) <= Reach(limits).slopes[:, 0].dot([abs(v), abs(a)]) + 1e-9


def test_setpoints_within_limits_pass_bit_for_bit(limiter, limits, cell):
    limiter.hold(np.arange(len(cell.home)), cell.home)
    motion = limits.motion
    amplitude = 0.2 * np.minimum(np.minimum(motion.velocity, motion.acceleration / 4.0), motion.jerk / 20.0)
    amplitude = np.minimum(amplitude, np.minimum(limits.upper - cell.home, cell.home - limits.lower).clip(0.0) * 0.9)
    for k in range(1, 500):
        t = DT * k
        rise, fall = np.sin(2 * t), np.cos(2 * t)
        ramp = min(t, 1.0) ** 3 * (10 - 15 * min(t, 1.0) + 6 * min(t, 1.0) ** 2)
        slope = 30 * min(t, 1.0) ** 2 * (1 - min(t, 1.0)) ** 2
        bend = 60 * min(t, 1.0) * (1 - min(t, 1.0)) * (1 - 2 * min(t, 1.0))
        wanted = np.array(
            [
                cell.home + amplitude * ramp * rise,
                amplitude * (slope * rise + 2 * ramp * fall),
                amplitude * (bend * rise + 4 * slope * fall - 4 * ramp * rise),
            ]
        )
        given_ = wanted.copy()
        assert not limiter.limit(wanted)
        np.testing.assert_array_equal(wanted, given_)
    assert not limiter.counts.any()


@pytest.mark.parametrize("seed", range(2))
def test_whatever_is_wanted_what_passes_is_within_the_limits(limiter, limits, cell, seed):
    """Leaps, noise, ramps beyond the end of the range, impossible velocities."""
    random = np.random.default_rng(seed)
    limiter.hold(np.arange(len(cell.home)), cell.home)
    last = at_rest(cell.home)
    target = cell.home
    for k in range(1200):
        if k % 60 == 0:
            target = random.uniform(limits.lower - 0.5, limits.upper + 0.5)
        v, a = (random.normal(0.0, size, len(target)) for size in (3.0, 20.0))
        wanted = np.array([target, v * (k % 2), a * (k % 3)])
        limiter.limit(wanted)
        q, v, a = wanted
        ceiling = limits.ceiling
        assert (np.abs(v) <= ceiling.velocity * 1.001).all()
        assert (np.abs(a) <= ceiling.acceleration * 1.001).all()
        assert (np.abs(a - last[2]) <= JERK_FACTOR * ceiling.jerk * DT * 1.001).all()
        np.testing.assert_allclose(q, last[0] + DT * last[1], atol=ceiling.acceleration.max() * DT**2)
        assert (q >= limits.lower - 1e-5).all()
        assert (q <= limits.upper + 1e-5).all()
        rest = stopping_position(q, v, a, ceiling)
        assert (rest >= limits.lower - 1e-4).all()
        assert (rest <= limits.upper + 1e-4).all()
        last = wanted.copy()
    assert (limiter.counts[[KINDS.index(kind) for kind in ("velocity", "acceleration", "jerk")]] > 0).all()
    assert limiter.counts[KINDS.index("position")].any()


def test_a_leap_is_caught_up_with_and_then_followed_again(limiter, cell):
    limiter.hold(np.arange(len(cell.home)), cell.home)
    goal = cell.home.copy()
    goal[3] -= 0.2
    for _ in range(600):
        wanted = at_rest(goal)
        limiter.limit(wanted)
    np.testing.assert_allclose(wanted[0], goal, atol=1e-9)
    assert not limiter.limit(at_rest(goal))
    cut = limiter.counts.any(axis=0)
    assert cut[3]
    assert not np.delete(cut, 3).any()  # the other joints were let through


def test_a_joint_out_of_its_range_may_stay_and_come_back_but_not_go_on(limiter, limits, cell):
    outside = cell.home.copy()
    outside[4] = limits.upper[4] + 0.03
    limiter.hold(np.arange(len(outside)), outside)
    wanted = at_rest(outside)
    assert not limiter.limit(wanted)
    further = outside.copy()
    further[4] += 0.1
    for _ in range(100):
        wanted = at_rest(further)
        limiter.limit(wanted)
        assert wanted[0, 4] <= outside[4] + 1e-9
    back = outside.copy()
    back[4] = limits.upper[4] - 0.05
    for _ in range(400):
        wanted = at_rest(back)
        limiter.limit(wanted)
    assert wanted[0, 4] == pytest.approx(back[4], abs=1e-9)


def test_nan_is_refused_and_names_the_joint(limiter, cell):
    limiter.hold(np.arange(len(cell.home)), cell.home)
    for row in range(3):
        wanted = at_rest(cell.home)
        wanted[row, 3] = np.nan
        with pytest.raises(DataError, match=cell.joint_names[3]):
            limiter.limit(wanted)


def test_joints_without_control_are_left_alone(limiter, cell):
    controlled = np.arange(len(cell.home) - 1)
    limiter.hold(controlled, cell.home[:-1])
    wanted = at_rest(cell.home)
    wanted[0, -1] += 1.0
    assert not limiter.limit(wanted)
    limiter.release(controlled)
    wanted[0, 2] += 1.0
    assert not limiter.limit(wanted)
