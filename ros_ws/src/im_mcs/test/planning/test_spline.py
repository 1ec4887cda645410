"""Trajectories in time: which spline, what is refused, tolerances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BPoly, CubicHermiteSpline, CubicSpline
from scipy.linalg import solve_banded

from im_core.errors import LimitError
from im_mcs.planning.trajectories import interpolation
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial, quintic
from im_mcs.planning.trajectories.trajectory import Setpoint
from im_mcs.protocol.points import TimedPoints

TIMES = np.array([1.5, 2.5, 4.0, 5.5])


def points(times, q, v=None, a=None):
    given = [{"time": float(t), "positions": x.tolist()} for t, x in zip(times, q, strict=True)]
    for name, rows in (("velocities", v), ("accelerations", a)):
        for point, row in zip(given, rows if rows is not None else [], strict=False):
            point[name] = row.tolist()
    return given


@pytest.fixture
def course(rig, way):
    """Positions, velocities and accelerations of a smooth course from rest, at the times above."""
    random = np.random.default_rng(3)
    q = rig.home + np.cumsum(random.uniform(-0.2, 0.2, (4, 9)), axis=0) * way
    v = np.vstack([random.uniform(-0.1, 0.1, (3, 9)) * way, np.zeros(9)])
    a = np.vstack([random.uniform(-0.1, 0.1, (3, 9)) * way, np.zeros(9)])
    return q, v, a


def follow(rig, given, **more):
    """Follow a trajectory to its end; its goal, and when its setpoints began."""
    goal = rig.request({"kind": "trajectory", "points": given, **more})
    begin = len(rig.trace)
    while rig.group.planner.progress == 1.0 and rig.tick < 50:
        rig.ticks(1)
    begin = len(rig.trace) - 2
    rig.run()
    return goal, begin


def compare(rig, begin, reference, orders=3, atol=2e-6):
    """Setpoints at knots are those of a reference given as callables of time and order of the derivative."""
    for k in range(2, int(TIMES[-1] / 0.0045) - 1, 2):
        s, t = rig.trace[begin + k], k * 0.0045
        for order, got in enumerate((s.q, s.v, s.a)[:orders]):
            np.testing.assert_allclose(got, reference(t, order), atol=atol * 10**order)


def test_cubic_where_velocities_are_given(rig, course):
    """Its acceleration jumps: it is followed on its path, but a little later."""
    q, v, _ = course
    goal, begin = follow(rig, points(TIMES, q, v))
    assert rig.code(goal) is None
    spline = CubicHermiteSpline([0.0, *TIMES], np.vstack([rig.home, q]), np.vstack([np.zeros(9), v]))
    trajectory = rig.group.planner.follower.trajectory
    assert TIMES[-1] < trajectory.duration < TIMES[-1] + 0.4
    for k in range(2, int(trajectory.duration / rig.period), 2):
        place = trajectory.asked_time(k * rig.period)
        np.testing.assert_allclose(rig.trace[begin + k].q, spline(place), atol=3e-4)
    np.testing.assert_allclose(rig.trace[-1].q, q[-1], atol=1e-12)
    rig.check_motion()


def test_quintic_where_accelerations_are_given_too(rig, course):
    q, v, a = course
    goal, begin = follow(rig, points(TIMES, q, v, a))
    assert rig.code(goal) is None
    rows = np.stack([np.vstack([rig.home, q]), np.vstack([np.zeros(9), v]), np.vstack([np.zeros(9), a])], axis=1)
    spline = BPoly.from_derivatives([0.0, *TIMES], rows)
    compare(rig, begin, lambda t, order: spline(t, nu=order))
    rig.check_motion()


def test_positions_alone_are_joined_without_jumps_of_acceleration(rig, way):
    q = rig.home + np.outer([0.2, 0.35, 0.25, 0.1], way)
    goal, begin = follow(rig, points(TIMES, q))
    assert rig.code(goal) is None
    spline = CubicSpline([0.0, *TIMES], np.vstack([rig.home, q]), bc_type="clamped")
    for k in range(2 * round(TIMES[0] / 0.009) + 4, 2 * int(TIMES[2] / 0.009) - 2, 2):
        s, t = rig.trace[begin + k], k * 0.0045
        np.testing.assert_allclose(s.q, spline(t), atol=2e-6)
        np.testing.assert_allclose(s.a, spline(t, 2), atol=2e-4)
    rig.check_motion()


intervals = st.lists(st.floats(1e-3, 10.0), min_size=2, max_size=12)


@given(intervals, st.integers(0, 1000), st.booleans())
def test_positions_alone_lead_beyond_no_point(lengths, seed, there_and_back):
    """Not at all while a joint goes on in one direction; where it turns by less than a fifth of the way around."""
    random = np.random.default_rng(seed)
    count = len(lengths)
    steps = 10.0 ** random.uniform(-3.0, 0.0, (count, 9)) * random.choice([0.0, 1.0, 1.0, 1.0], (count, 9))
    if there_and_back:
        steps *= random.choice([-1.0, 1.0], (count, 9))
    h, q = np.array(lengths), np.vstack([np.zeros(9), np.cumsum(steps, axis=0)])
    rows = quintic(h, q, *interpolation.smooth(h, q, np.zeros(9), np.zeros(9)))
    spline = PiecewisePolynomial(h, rows)
    ways = np.abs(np.vstack([np.zeros(9), steps, np.zeros(9)]))
    for k in range(count):
        between = spline.span(spline.edges[k] + h[k] * np.linspace(0.0, 0.999, 50)).q
        beyond = np.maximum(between - np.maximum(q[k], q[k + 1]), np.minimum(q[k], q[k + 1]) - between).max(axis=0)
        most = 0.2 * ways[k : k + 3].max(axis=0) if there_and_back else 0.0
        assert (beyond <= most + 1e-9).all()


@pytest.mark.parametrize("seconds", [1e-9, 2e-9])
def test_what_is_asked_for_within_a_nanosecond_is_gone_to(rig, way, seconds):
    goal = rig.request({"kind": "trajectory", "points": [{"time": seconds, "positions": (rig.home + way).tolist()}]})
    rig.run()
    assert rig.code(goal) is None
    np.testing.assert_allclose(rig.trace[-1].q, rig.home + way, atol=1e-9)


def test_a_point_far_away_at_once_is_gone_to_and_not_passed(rig):
    """As where a client's clock is behind: what is left begins with a leap, and goes on slowly."""
    q = np.tile(rig.home, (4, 1))
    q[:, 3] += [0.5, 0.6, 0.7, 0.8]
    goal, _ = follow(rig, points([0.01, 0.51, 1.01, 1.51], q))
    assert rig.code(goal) is None
    assert (np.diff(rig.q[:, 3]) >= -1e-6).all()
    assert rig.q[:, 3].max() <= rig.home[3] + 0.8 + 1e-6
    rig.check_motion()


@pytest.mark.parametrize("derivatives", [0, 1, 2])
def test_standing_takes_the_time_that_was_asked_for(rig, way, derivatives):
    still = [np.zeros((2, 9))] * derivatives
    goal, begin = follow(rig, points([0.9, 3.0], np.vstack([rig.home, rig.home + 0.2 * way]), *still))
    assert rig.code(goal) is None
    moved = begin + int(np.argmax((rig.q[begin:] != rig.home).any(axis=1)))
    assert (moved - begin) * rig.period == pytest.approx(0.9, abs=3 * 0.0045)
    assert rig.results[goal][1]["duration"] >= 3.0


def test_a_first_point_at_time_0_is_where_the_arm_is(rig, course):
    q, _, _ = course
    goal, _ = follow(rig, points([0.0, *TIMES], np.vstack([rig.home + 1e-3, q])))
    assert rig.code(goal) is None
    rig.check_motion()
    away = np.vstack([rig.trace[-1].q - 0.2, q])
    goal, _ = follow(rig, points([0.0, *TIMES], away))
    assert rig.code(goal) == "limit"
    assert "time 0" in rig.results[goal][0].message


# times, positions, velocities of left_j1 on its way there and back; no accelerations at the points
BEYOND = {
    "position": ([4.0, 6.0, 10.0], [2.77, 2.77, 0.0], [1.0, 0.0, 0.0]),
    "velocity": ([2.0, 2.5, 4.5], [1.0, 1.66, 2.66], [1.2, 1.2, 0.0]),
    "acceleration": ([2.0, 3.0, 5.0], [-1.0, -1.0, 0.0], [-1.3, 1.3, 0.0]),
    "jerk": ([1.0, 1.1, 3.0], [0.05, 0.061, 0.3], [0.1, 0.1, 0.0]),
}


@pytest.mark.parametrize("kind", BEYOND)
def test_what_goes_beyond_a_limit_between_points_is_refused_before_it_moves(make_rig, refusing, kind):
    rig = make_rig() if kind == "position" else make_rig(planning=refusing)
    times, q1, v1 = BEYOND[kind]
    q, v = np.tile(rig.home, (3, 1)), np.zeros((3, 9))
    q[:, 3], v[:, 3] = q1, v1
    before = rig.trace[-1].q
    goal, _ = follow(rig, points(times, q, v, np.zeros((3, 9))))
    fault = rig.results[goal][0]
    assert isinstance(fault, LimitError)
    assert fault.facts["joint"] == "left_j1"
    assert f"left_j1: {kind} at" in fault.message
    assert 0.0 < fault.facts["time"] < times[-1]
    np.testing.assert_array_equal(rig.q, np.tile(before, (len(rig.trace), 1)))


def test_a_jump_of_acceleration_is_beyond_the_limit_of_jerk(make_rig, refusing, course):
    rig, (q, v, _) = make_rig(planning=refusing), course
    goal, _ = follow(rig, points(TIMES, q, v))
    fault = rig.results[goal][0]
    assert "jerk at 0.000 s of the trajectory, where its acceleration jumps by" in fault.message
    assert rig.code(goal) == "limit"
    assert not rig.v.any()


def test_an_error_beyond_the_path_tolerance_ends_it_on_the_path(rig, course):
    q, _, _ = course
    goal = rig.request({"kind": "trajectory", "points": points(TIMES, q), "path_tolerance": [-1.0] * 4 + [0.01] * 5})
    rig.error[3] = 0.5  # no bound
    rig.ticks(200)
    assert goal not in rig.results
    rig.error[5] = 0.02
    rig.ticks(1)
    rig.error[:] = 0.0
    rig.run()
    fault = rig.results[goal][0]
    assert fault.code == "path_tolerance"
    assert fault.facts["joint"] == "left_j3"
    assert fault.facts["tick"] == 201
    assert "0.02 rad is beyond the path tolerance 0.01 rad at tick 201" in fault.message
    rig.check_motion()


def test_the_default_path_tolerance_is_the_bound_of_the_following_error(rig, course):
    q, _, _ = course
    goal = rig.request({"kind": "trajectory", "points": points(TIMES, q)})
    rig.ticks(100)
    rig.error[0] = 1.01 * rig.all_limits.following_error[0]
    rig.ticks(1)
    rig.error[0] = 0.0
    rig.run()
    assert rig.code(goal) == "path_tolerance"


def test_a_goal_tolerance_holds_also_once_the_arm_has_settled(rig, course, config):
    q, _, _ = course
    settle = config.servo.settle
    for seconds, least, most in ((1.0, 1.0, 1.02), (0.0, settle.window_ticks * rig.period, settle.timeout_s / 2)):
        more = {"goal_tolerance": [0.0] * 4 + [1e-5] * 5, "goal_time_tolerance": seconds}
        goal = rig.request({"kind": "trajectory", "points": points(TIMES, q), **more})
        rig.error[7] = 2e-5
        assert rig.error[7] < settle.tolerance
        rig.run()
        assert rig.code(goal) == "goal_tolerance"
        assert least <= rig.results[goal][1]["duration"] - TIMES[-1] <= most


@pytest.mark.parametrize(("error", "code"), [(0.004, None), (0.006, "goal_tolerance")])
def test_the_goal_tolerance_decides_at_the_end(rig, course, error, code):
    q, _, _ = course
    more = {"goal_tolerance": [0.0] * 4 + [0.005] * 5, "goal_time_tolerance": 0.1}
    goal = rig.request({"kind": "trajectory", "points": points(TIMES, q), **more})
    rig.error[7] = error
    while goal not in rig.results:
        rig.ticks(1)
    fault, results, _ = rig.results[goal]
    assert rig.code(goal) == code
    late = 0.1 if code else 0.0
    assert results["duration"] == pytest.approx(TIMES[-1] + late, abs=0.02)
    if code:
        assert "left_j5: error 0.006 rad is beyond the goal tolerance 0.005 rad" in fault.message


def test_an_error_of_velocity_beyond_its_path_tolerance_ends_it(rig, course):
    q, _, _ = course
    more = {"path_velocity_tolerance": [-1.0] * 4 + [0.1] * 5}
    goal = rig.request({"kind": "trajectory", "points": points(TIMES, q), **more})
    rig.velocity_error[3] = 5.0  # no bound
    rig.ticks(200)
    assert goal not in rig.results
    rig.velocity_error[5] = -0.2
    rig.ticks(1)
    rig.velocity_error[:] = 0.0
    rig.run()
    fault = rig.results[goal][0]
    assert (fault.code, fault.facts["joint"]) == ("path_tolerance", "left_j3")
    assert "left_j3: velocity error -0.2 rad/s is beyond the path tolerance 0.1 rad/s at tick 201" in fault.message
    rig.check_motion()


@pytest.mark.parametrize(("error", "code"), [(0.04, None), (0.06, "goal_tolerance")])
def test_the_velocity_at_the_end_is_judged_if_asked_for(rig, course, error, code):
    q, _, _ = course
    more = {"goal_velocity_tolerance": [-1.0] * 4 + [0.05] * 5, "goal_time_tolerance": 0.1}
    goal = rig.request({"kind": "trajectory", "points": points(TIMES, q), **more})
    rig.velocity_error[0], rig.velocity_error[7] = 1.0, error
    while goal not in rig.results:
        rig.ticks(1)
    assert rig.code(goal) == code
    if code:
        assert "left_j5: velocity error 0.06 rad/s is beyond the goal tolerance" in rig.results[goal][0].message


def test_without_goal_tolerances_it_ends_with_the_trajectory_and_not_when_all_has_settled(rig, course, config):
    q, _, _ = course
    default = config.planning.goal
    for error, speed, code in (
        (0.9 * default.rad, 0.9 * default.stopped_velocity, None),
        (0.0, 1.1 * default.stopped_velocity, "goal_tolerance"),
        (1.1 * default.rad, 0.0, "goal_tolerance"),
    ):
        rig.error[7], rig.velocity_error[7] = error, speed
        goal = rig.request({"kind": "trajectory", "points": points(TIMES, q), "goal_time_tolerance": 0.05})
        while goal not in rig.results:
            rig.ticks(1)
        assert rig.code(goal) == code
        late = rig.results[goal][1]["duration"] - TIMES[-1]
        assert (0.05 if code else 0.0) <= late + 1e-9 <= (0.06 if code else 0.005)
        rig.error[:] = rig.velocity_error[:] = 0.0


@pytest.mark.parametrize(("given", "code"), [({}, None), ({"goal_tolerance": [0.005] * 9}, "goal_tolerance")])
def test_where_a_law_yields_only_a_given_tolerance_says_how_far_off_the_end_may_be(rig, course, config, given, code):
    rig.group.controller.name = config.switching.yielding[0]
    rig.error[7] = 0.02
    goal = rig.request({"kind": "trajectory", "points": points(TIMES, course[0]), **given})
    rig.run()
    assert rig.code(goal) == code


def test_a_move_ends_when_its_arm_has_settled(rig, way, config):
    goal = rig.move(rig.home + 0.1 * way)
    rig.run()
    stood = np.flatnonzero(rig.v.any(axis=1))[-1]
    assert rig.results[goal][2] - stood >= config.servo.settle.window_ticks + config.servo.rest_window_ticks


@pytest.mark.parametrize("kind", [1, 2, 3])
@pytest.mark.parametrize("first", [0.0, 0.3])
def test_a_spline_built_some_pieces_a_slice_is_the_same(rig, course, monkeypatch, kind, first):
    count = 500
    random = np.random.default_rng(kind)
    times = first + np.concatenate([[0.0], np.cumsum(random.uniform(0.02, 0.2, count - 1))])
    q, v, a = (rig.home * (k == 0) + random.normal(size=(count, 9)) for k in range(3))
    points_ = TimedPoints(times, q, v if kind > 1 else None, a if kind > 2 else None)
    start = Setpoint(q[0] if first == 0.0 else rig.home, 0.1 * np.ones(9), 0.2 * np.ones(9))
    found = {}
    for pieces in (1000, 7):
        monkeypatch.setattr(interpolation, "PIECES_AT_ONCE", pieces)

        def build():
            found[len(found)] = yield from interpolation.interpolated(points_, start, rig.limits)

        assert 1 + len(list(build())) == -(-(count - (first == 0.0)) // pieces)
    once, sliced = found[0], found[1]
    np.testing.assert_array_equal(sliced.edges, once.edges)
    assert sliced.points == once.points
    np.testing.assert_allclose(sliced.coefficients, once.coefficients, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(sliced.at(0.0).v, start.v)
    assert sliced.points[-1] == count - 1
    np.testing.assert_allclose(sliced.end_setpoint.v, 0.0)


def test_a_motion_ends_in_its_last_point_however_short_the_way_there(rig):
    """Rounding is no velocity from which to run out."""
    q = np.vstack([rig.home, rig.home])
    q[:, 6] += (0.2, 1.2)
    rest = np.zeros_like(q)
    goal, _ = follow(rig, points([1.0, 1.0 + 1e-9], q, rest, rest), goal_tolerance=[1e-3] * 9)
    assert rig.code(goal) is None
    np.testing.assert_allclose(rig.trace[-1].q, q[-1], atol=1e-6)


def test_a_point_out_of_range_is_named_however_far_behind(rig):
    count = 5000
    q = np.tile(rig.home, (count, 1))
    q[4321, 8] = 99.0
    goal = rig.request({"kind": "trajectory", "points": points(np.arange(1.0, count + 1.0), q)})
    rig.run()
    fault = rig.results[goal][0]
    assert isinstance(fault, LimitError)
    assert "left_j6: position of point 4322 99 rad is beyond the limit" in fault.message


@pytest.mark.parametrize("count", [1, 2, 3, 8, 117, 1000])
def test_systems_whose_diagonal_dominates_are_solved(count):
    random = np.random.default_rng(count)
    bands = random.uniform(-1.0, 1.0, (3, count))
    after, middle, before = bands[0, 1:], bands[1], bands[2, :-1]
    middle[:] = np.sign(middle) * random.uniform(1.5, 3.0, count)
    middle *= np.append(np.abs(after), 0.1) + np.append(0.1, np.abs(before))
    bands *= 10.0 ** random.uniform(-6.0, 3.0)
    right = random.normal(size=(count, 9))
    given = [array.copy() for array in (before, middle, after, right)]
    found = interpolation.solve_tridiagonal(before, middle, after, right)
    reference = solve_banded((1, 1), bands, right)
    np.testing.assert_allclose(found, reference, rtol=1e-12, atol=1e-14 * np.abs(reference).max())
    for array, copy in zip((before, middle, after, right), given, strict=True):
        np.testing.assert_array_equal(array, copy)
