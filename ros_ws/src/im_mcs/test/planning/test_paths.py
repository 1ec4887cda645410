"""Joint paths: legs, corners, their duration and their limits."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from ruckig import InputParameter, Ruckig, Synchronization, Trajectory

from im_core.errors import DataError
from im_mcs.limits.motion_limits import Synchrony
from im_mcs.planning import JointPath, MotionLimits
from im_mcs.planning.trajectories.profile import to_meet, to_point
from im_mcs.planning.trajectories.trajectory import Setpoint

LIMITS = MotionLimits(np.array([1.0, 2.0, 0.5]), np.array([2.0, 5.0, 1.0]), np.array([20.0, 30.0, 8.0]))
positions = st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3).map(np.array)
paths = st.lists(positions, min_size=1, max_size=5).map(np.array)
#: Shares of a limit; a motion takes what is far smaller for rounding, and for none.
shares = st.just(0.0) | st.floats(1e-3, 0.99) | st.floats(-0.99, -1e-3)


def within_limits(path, tolerance=1e-6):
    t = np.linspace(0.0, path.duration, 1500)
    s = path.span(t)
    assert (np.abs(s.v) <= LIMITS.velocity * (1 + tolerance)).all()
    assert (np.abs(s.a) <= LIMITS.acceleration * (1 + tolerance)).all()
    step = max(t[1] - t[0], 1e-12)
    assert (np.abs(np.diff(s.a, axis=0)) <= LIMITS.jerk * step * 1.001 + 1e-9).all()
    np.testing.assert_allclose(np.diff(s.q, axis=0), step * (s.v[1:] + s.v[:-1]) / 2, atol=30 * step**3 + 1e-12)
    return s


def rest_to_rest(distance, v, a, j):
    """Duration of the time-optimal jerk-limited motion over a distance, in closed form.

    L. Biagiotti, C. Melchiorri, "Trajectory Planning for Automatic Machines and Robots", 2008, 3.4.
    """
    if distance == 0.0:
        return 0.0
    a = min(a, np.sqrt(v * j))
    if distance >= v * (v / a + a / j):
        return distance / v + v / a + a / j
    if distance >= 2.0 * a**3 / j**2:
        return a / j + np.sqrt((a / j) ** 2 + 4.0 * distance / a)
    return 4.0 * np.cbrt(distance / (2.0 * j))


def optimum(start, end, synchrony):
    """Of the straight line, or of the slowest joint on its own."""
    way = np.abs(end - start)
    if synchrony is Synchrony.TIME:
        return max(
            rest_to_rest(*numbers)
            for numbers in zip(way, LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk, strict=True)
        )
    if way.max() < 1e-9:
        return 0.0
    with np.errstate(divide="ignore", over="ignore"):
        return rest_to_rest(
            1.0, *(np.min(limit / way) for limit in (LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk))
        )


@settings(max_examples=40, deadline=None)
@given(positions, paths, st.sampled_from(list(Synchrony)))
def test_without_blending_every_point_is_a_rest_and_the_duration_is_optimal(start, points, synchrony):
    path = JointPath(start, points, LIMITS, synchrony)
    within_limits(path)
    ends = np.cumsum([optimum(a, b, synchrony) for a, b in zip([start, *points], points, strict=False)])
    assert path.duration == pytest.approx(ends[-1], rel=1e-6, abs=1e-6)
    for end, point in zip(ends, points, strict=True):
        s = path.at(min(end, path.duration))
        np.testing.assert_allclose(s.q, point, atol=1e-6)
        np.testing.assert_allclose(s.v, 0.0, atol=1e-4)


@settings(max_examples=40, deadline=None)
@given(positions, paths, st.floats(0.01, 1.0))
def test_corners_stay_within_the_blend_and_within_limits(start, points, blend):
    path = JointPath(start, points, LIMITS, blend=blend)
    s = within_limits(path)
    for point in points:
        assert np.abs(s.q - point).max(axis=1).min() <= blend + 1e-9
    np.testing.assert_allclose(path.end_setpoint.q, points[-1], atol=1e-12)
    # off the corners it runs along the straight legs
    legs = list(zip([start, *points], points, strict=False))
    for q in s.q[::50]:
        off = min(_distance(q, a, b) for a, b in legs)
        near = min(np.abs(q - point).max() for point in points)
        assert off < 1e-6 or near <= blend + 1e-9


def _distance(q, a, b):
    way = b - a
    share = 0.0 if way @ way == 0.0 else np.clip((q - a) @ way / (way @ way), 0.0, 1.0)
    return np.abs(q - a - share * way).max()


def test_a_rounded_zigzag_is_faster_than_one_with_rests():
    points = np.array([[0.8, -0.9, 0.1], [0.9, 0.4, 0.3], [0.1, 0.5, -0.2], [0.0, 0.0, 0.4]])
    assert JointPath(np.zeros(3), points, LIMITS, blend=0.3).duration < JointPath(np.zeros(3), points, LIMITS).duration


def test_phase_synchronised_is_straight():
    end = np.array([0.8, -0.9, 0.3])
    path = JointPath(np.zeros(3), end[None, :], LIMITS)
    share = path.span(np.linspace(0.05, path.duration, 30)).q / end
    np.testing.assert_allclose(share, share[:, :1] * np.ones(3), atol=1e-9)


def test_points_tell_where_the_motion_goes_and_repeated_points_cost_nothing():
    a, b = np.array([0.3, 0.0, 0.0]), np.array([0.3, 0.3, 0.1])
    path = JointPath(np.zeros(3), np.array([a, a, b]), LIMITS)
    assert path.duration == pytest.approx(JointPath(np.zeros(3), np.array([a, b]), LIMITS).duration)
    seen = [path.point(t) for t in np.linspace(0.0, path.duration, 50)]
    assert seen == sorted(seen)
    assert set(seen) == {0, 2}
    assert JointPath(a, a[None, :], LIMITS).duration == 0.0


@settings(max_examples=40, deadline=None)
@given(positions, shares, shares, positions)
def test_a_motion_under_way_is_led_on_without_a_leap(q, speed, force, end):
    assume(all(away == 0.0 or away > 1e-6 for away in np.abs(end - q)))  # the same for places
    start = Setpoint(q, speed * LIMITS.velocity, force * LIMITS.acceleration * (1 - abs(speed)))
    path = to_point(start, end, LIMITS)
    first, last = path.at(0.0), path.at(path.duration)
    for got, wanted in ((first.q, start.q), (first.v, start.v), (first.a, start.a), (last.q, end)):
        np.testing.assert_allclose(got, wanted, atol=1e-7)
    asked, found = InputParameter(3), Trajectory(3)
    asked.current_position, asked.current_velocity, asked.current_acceleration = (
        x.tolist() for x in (start.q, start.v, start.a)
    )
    asked.target_position, asked.synchronization = end.tolist(), Synchronization.Phase
    asked.max_velocity, asked.max_acceleration = LIMITS.velocity.tolist(), LIMITS.acceleration.tolist()
    asked.max_jerk = LIMITS.jerk.tolist()
    Ruckig(3).calculate(asked, found)
    assert path.duration == pytest.approx(found.duration, abs=1e-8)
    for t in np.linspace(0.0, path.duration, 20)[:-1]:
        np.testing.assert_allclose(path.at(t).q, found.at_time(t)[0], atol=1e-7)


def test_what_ruckig_refuses_is_a_sentence():
    with pytest.raises(DataError, match="no trajectory"):
        to_point(Setpoint.at_rest(np.zeros(3)), np.full(3, np.nan), LIMITS)


@pytest.mark.parametrize("small", [1e-17, 1e-15, 1e-13, 1e-11, 1e-9, 1e-7, 1e-6])
def test_a_joint_that_all_but_stands_still_stays_while_others_move(small):
    """Ruckig sends it away and back where rounding alone tells its state from rest."""
    random = np.random.default_rng(1)
    none = np.zeros(3)
    for _ in range(300):
        start = Setpoint(*(small * random.normal(size=3) * random.integers(0, 2, 3) for _ in range(3)))
        start.q[0], start.v[0], start.a[0] = random.uniform(-0.1, 0.1), random.uniform(-0.3, 0.3), random.uniform(-1, 1)
        end = np.array([random.uniform(-0.1, 0.1), *(small * random.normal(size=2))])
        for motion in (to_meet(start, end, none, LIMITS), to_point(start, end, LIMITS)):
            q = motion.span(np.linspace(0.0, motion.duration, 60)).q
            assert np.abs(q[:, 1:]).max() < 100.0 * small + 1e-9
