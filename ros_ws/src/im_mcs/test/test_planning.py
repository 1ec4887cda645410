import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_mcs.planning import GroupPlanner, JointPath, MotionLimits, StopTrajectory
from im_mcs.planning.joint_path import Synchrony

LIMITS = MotionLimits(np.array([1.0, 2.0, 0.5]), np.array([2.0, 5.0, 1.0]), np.array([20.0, 30.0, 8.0]))
positions = st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3).map(np.array)


@settings(max_examples=40, deadline=None)
@given(positions, st.lists(positions, min_size=1, max_size=3), st.sampled_from(list(Synchrony)))
def test_a_path_passes_its_points_within_limits(start, points, synchrony):
    path = JointPath(start, np.array(points), LIMITS, synchrony)
    samples = [path.at(t) for t in np.linspace(0.0, path.duration, 200)]
    np.testing.assert_allclose(samples[0].q, start, atol=1e-9)
    np.testing.assert_allclose(path.at(path.duration + 1.0).q, points[-1])
    for s in samples:
        assert (np.abs(s.v) <= LIMITS.velocity + 1e-6).all()
        assert (np.abs(s.a) <= LIMITS.acceleration + 1e-6).all()
    for number, point in enumerate(points):
        ends = [*path._starts[1:], path.duration]
        at = path.at(ends[number])
        np.testing.assert_allclose(at.q, point, atol=1e-6)
        np.testing.assert_allclose(at.v, 0.0, atol=1e-6)


def test_phase_synchronised_is_straight_and_time_optimal():
    start, end = np.zeros(3), np.array([0.8, -0.9, 0.3])
    path = JointPath(start, end[None, :], LIMITS)
    for t in np.linspace(0.05, path.duration, 30):
        fraction = path.at(t).q / end
        np.testing.assert_allclose(fraction, fraction[0], atol=1e-9)
    slowest = max(JointPath(np.zeros(1), np.array([[end[i]]]), LIMITS.of(np.array([i]))).duration for i in range(3))
    assert path.duration == pytest.approx(slowest, rel=1e-9)


@pytest.mark.parametrize("divisor", [1, 2, 3, 7])
def test_setpoints_are_continuous_whatever_the_divisor(divisor):
    planner = GroupPlanner(np.zeros(3), 0.0045, divisor, LIMITS)
    path = JointPath(np.zeros(3), np.array([[0.8, -0.9, 0.3], [0.1, 0.2, 0.1]]), LIMITS)
    planner.follow(path)
    last = planner.setpoint
    tick = 0
    while not planner.finished:
        s = planner.advance()
        tick += 1
        np.testing.assert_allclose(s.q, path.at(tick * 0.0045).q, atol=30.0 * (divisor * 0.0045) ** 3)
        assert (np.abs(s.q - last.q) <= LIMITS.velocity * 0.0045 * 1.01).all()
        last = s
    assert planner.point == 1
    np.testing.assert_allclose(last.q, [0.1, 0.2, 0.1], atol=1e-12)
    assert planner.advance() is planner.advance()


def test_stopping_is_continuous_and_within_limits():
    planner = GroupPlanner(np.zeros(3), 0.0045, 2, LIMITS)
    planner.follow(JointPath(np.zeros(3), np.array([[1.0, -1.0, 0.8]]), LIMITS))
    for _ in range(120):
        before = planner.advance()
    planner.stop()
    samples = [before]
    while not planner.finished:
        samples.append(planner.advance())
    v = np.array([s.v for s in samples])
    assert (np.abs(np.diff(v, axis=0)) <= LIMITS.acceleration * 0.0045 * 1.05).all()
    np.testing.assert_allclose(samples[-1].v, 0.0, atol=1e-9)
    assert StopTrajectory(samples[-1], LIMITS).duration == pytest.approx(0.0, abs=1e-9)
