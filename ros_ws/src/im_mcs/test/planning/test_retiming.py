"""Trajectories that ask for more than limits allow: on their own path, within limits, at rest where they end."""

import re
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BPoly, CubicHermiteSpline, CubicSpline

from im_core.errors import ImError
from im_mcs.limits.saturation import Saturations
from im_mcs.planning.retiming import stretch
from im_mcs.planning.retiming.stretch import least_ahead
from im_mcs.planning.trajectories.trajectory import Setpoint
from im_mcs.safety import SetpointLimiter

FINE_S = 0.0005
OFF = {"rad": 1e-3, "m": 1e-4}
PERIODS = (0.0045, 0.001, 0.002)


def points(times, *rows):
    names = ("positions", "velocities", "accelerations")
    return [
        {"time": float(t), **{name: row[k].tolist() for name, row in zip(names, rows, strict=False)}}
        for k, t in enumerate(times)
    ]


def follow(rig, times, *rows, **more):
    """Follow a trajectory to its end; its goal, what was followed, and from which setpoint on."""
    goal = rig.request({"kind": "trajectory", "points": points(times, *rows), **more})
    before = rig.group.planner.follower
    for _ in range(5000):
        if rig.group.planner.follower is not before or goal in rig.results:
            break
        rig.ticks(1)
    begin = len(rig.trace) - 2
    trajectory = getattr(rig.group.planner.follower, "trajectory", None)
    rig.run()
    return goal, trajectory, begin


def units(rig):
    return np.array([OFF[rig.all_limits.units[i]] for i in rig.index])


def check_limits(rig, trajectory):
    """Velocity, acceleration and jerk of a whole trajectory, on a grid finer than any servo's, and its two rests."""
    step = min(FINE_S, trajectory.duration / 400.0)
    t = np.append(np.arange(0.0, trajectory.duration, step), trajectory.duration)
    s, limits = trajectory.span(t), rig.limits
    assert (np.abs(s.v) <= 1.001 * limits.velocity).all()
    assert (np.abs(s.a) <= 1.001 * limits.acceleration).all()
    # the last setpoint is at rest by definition: what leads to it counts
    assert (np.abs(np.diff(s.a, axis=0)) <= 1.001 * limits.jerk * np.diff(t)[:, None] + 1e-9).all()
    assert not s.v[-1].any()
    assert np.abs(s.v[0]).max() < 1e-9
    assert np.abs(s.a[0]).max() < 1e-9


def check_executed(rig, config):
    """The limiter lets every setpoint through."""
    counts, names = Saturations(18), rig.all_limits.names
    plan_s = rig.period * rig.group.planner.divisor
    limiter = SetpointLimiter(rig.all_limits, rig.period, plan_s, config.safety.jerk_factor, counts)
    limiter.hold(rig.index, rig.trace[0].q)
    for setpoint in rig.trace:
        wanted = np.zeros((3, len(names)))
        wanted[:, rig.index] = setpoint.q, setpoint.v, setpoint.a
        assert not limiter.limit(wanted)
    assert not counts.counts.any()


def off_path(path, knots, q, unit):
    """Largest distance of positions from an asked path, in units: from lines between places close together on it."""
    places = path(np.unique(np.concatenate([np.linspace(a, b, 401) for a, b in pairwise(knots)]))) / unit
    begins, ways = places[:-1], np.diff(places, axis=0)
    sizes, worst = np.maximum((ways * ways).sum(axis=1), 1e-300), 0.0
    for row in q / unit:
        share = np.clip(((row - begins) * ways).sum(axis=1) / sizes, 0.0, 1.0)
        worst = max(worst, float(np.abs(row - begins - share[:, None] * ways).max(axis=1).min()))
    return worst


def trapezoid(step, share, way, limits):
    """Times, positions, velocities, accelerations of a trapezoidal profile along a way, without its first point."""
    speed, force = share * (limits.velocity / np.abs(way)).min(), share * (limits.acceleration / np.abs(way)).min()
    peak = min(speed, np.sqrt(force))
    ramp = peak / force
    end = 1.0 / peak + ramp
    t = np.append(np.arange(step, end - step / 2.0, step), end)
    covered = np.where(t < ramp, 0.5 * force * t**2, 0.5 * force * ramp**2 + peak * (t - ramp))
    covered = np.where(t > end - ramp, 1.0 - 0.5 * force * (end - t) ** 2, covered)
    change = np.where(t < ramp, force, np.where(t > end - ramp, -force, 0.0))
    return t, *(x[:, None] * way for x in (covered, np.minimum(peak, force * np.minimum(t, end - t)), change))


@pytest.mark.parametrize("many", [1, 2, 3])
@pytest.mark.parametrize(("step", "share"), [(0.1, 0.5), (0.02, 0.9), (0.01, 0.1)])
def test_trapezoidal_profiles_stay_on_their_line(rig, way, config, step, share, many):
    t, *rows = trapezoid(step, share, way, rig.limits)
    rows[0] += rig.home
    goal, trajectory, _ = follow(rig, t, *rows[:many])
    assert rig.code(goal) is None
    told = f"re-timed along its path: {trajectory.duration:.3f} s instead of {t[-1]:.3f} s, because of "
    assert rig.results[goal][1]["retimed"].startswith(told)
    off = rig.q - rig.home
    off -= (off @ way / (way @ way))[:, None] * way
    assert np.abs(off).max() < 1e-7
    np.testing.assert_allclose(rig.trace[-1].q, rows[0][-1], atol=1e-9)
    assert t[-1] <= trajectory.duration < t[-1] + 0.5
    check_limits(rig, trajectory)
    check_executed(rig, config)
    rig.check_motion()


@pytest.mark.parametrize("shape", ["cosine", "minimum jerk"])
def test_smooth_profiles_with_velocities_stay_on_their_line(rig, way, config, shape):
    x = np.linspace(0.0, 1.0, 21)[1:, None]
    covered, speed = (
        ((1.0 - np.cos(np.pi * x)) / 2.0, np.pi * np.sin(np.pi * x) / 2.0)
        if shape == "cosine"
        else (x**3 * (10.0 + x * (6.0 * x - 15.0)), 30.0 * (x * (1.0 - x)) ** 2)
    )
    goal, trajectory, _ = follow(rig, 2.0 * x[:, 0], rig.home + covered * way, speed * way / 2.0)
    assert rig.code(goal) is None
    off = rig.q - rig.home
    off -= (off @ way / (way @ way))[:, None] * way
    assert np.abs(off).max() < 1e-7
    np.testing.assert_allclose(rig.trace[-1].q, rig.home + way, atol=1e-9)
    assert trajectory.duration < 2.2
    check_limits(rig, trajectory)
    check_executed(rig, config)


@settings(max_examples=6, deadline=None)
@given(data=st.data())
@pytest.mark.parametrize("many", [1, 2, 3])
def test_whatever_is_asked_for_is_followed_on_its_path_or_refused(make_rig, config, many, data):
    """Random courses, most of them far too fast: curved ones, duplicate points, pieces of a millisecond, all joints."""
    whole = data.draw(st.booleans())
    rig = make_rig(name="testbed", preset="1x18") if whole else make_rig()
    n, count = len(rig.index), data.draw(st.integers(1, 4))
    random = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    h = data.draw(st.lists(st.sampled_from([0.001, 0.05, 0.2, 0.6]), min_size=count, max_size=count))
    lower, upper = rig.all_limits.lower[rig.index] + 0.3, rig.all_limits.upper[rig.index] - 0.3
    size = data.draw(st.sampled_from([0.02, 0.1, 0.3]))
    q = np.clip(rig.home + np.cumsum(random.normal(size=(count, n)) * size, axis=0), lower, upper)
    if count > 1 and data.draw(st.booleans()):
        q[1] = q[0]
    times = np.cumsum(h)
    v = random.normal(size=(count, n)) * data.draw(st.sampled_from([0.0, 0.2])) * rig.limits.velocity
    a = random.normal(size=(count, n)) * data.draw(st.sampled_from([0.0, 0.3])) * rig.limits.acceleration
    v[-1], a[-1] = 0.0, 0.0
    check_followed_or_refused(rig, config, times, *(q, v, a)[:many])


@pytest.mark.parametrize("seed", range(4))
def test_a_path_that_turns_within_a_microsecond_rests_there(make_rig, config, seed):
    """A point given twice, a millisecond apart, with a velocity the first time: out and back on a line, nearly."""
    rig = make_rig()
    random = np.random.default_rng(seed)
    q = np.tile(rig.home + random.normal(size=len(rig.index)) * 0.05, (2, 1))
    v = random.normal(size=q.shape) * 0.2 * rig.limits.velocity
    v[-1] = 0.0
    check_followed_or_refused(rig, config, np.array([0.6, 0.601]), q, v)


def test_a_turn_that_is_found_twice_by_rounding_is_one_rest(make_rig, config):
    rig = make_rig()
    aside, _, first = np.random.default_rng(549).normal(size=(3, 2, len(rig.index)))
    q = np.tile(rig.home + aside[0] * 0.02, (2, 1))
    v, a = np.zeros_like(q), first * 0.3 * rig.limits.acceleration
    a[-1] = 0.0
    check_followed_or_refused(rig, config, np.array([0.6, 0.8]), q, v, a)


def check_followed_or_refused(rig, config, times, *states):
    goal, trajectory, begin = follow(rig, times, *states)
    if rig.code(goal) is not None:
        assert rig.code(goal) == "limit"
        assert "position at" in rig.results[goal][0].message
        assert not rig.v.any()
        return
    check_limits(rig, trajectory)
    check_executed(rig, config)
    np.testing.assert_allclose(rig.trace[-1].q, states[0][-1], atol=1e-9)
    assert not rig.trace[-1].v.any()
    assert not rig.trace[-1].a.any()
    assert trajectory.duration >= times[-1] - 1e-9
    if len(states) == 1:
        return  # which spline joins positions alone is looked at in test_spline.py
    knots, starts = np.concatenate([[0.0], times]), (rig.home, np.zeros_like(rig.home), np.zeros_like(rig.home))
    rows = [np.vstack([start, state]) for start, state in zip(starts, states, strict=False)]
    path = CubicHermiteSpline(knots, *rows) if len(rows) == 2 else BPoly.from_derivatives(knots, np.stack(rows, axis=1))
    assert off_path(path, knots, rig.q[begin::4], units(rig)) <= 1.0


def test_a_trajectory_within_limits_keeps_its_time_to_the_last_digit(rig, way):
    x = np.linspace(0.0, 1.0, 6)[1:, None]
    covered, speed = x**3 * (10.0 + x * (6.0 * x - 15.0)), 30.0 * (x * (1.0 - x)) ** 2
    change = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)
    rows = rig.home + covered * way, speed * way / 4.0, change * way / 16.0
    goal, trajectory, _ = follow(rig, 4.0 * x[:, 0], *rows)
    assert rig.code(goal) is None
    assert "retimed" not in rig.results[goal][1]
    assert trajectory.duration == 4.0
    np.testing.assert_allclose(trajectory.span(4.0 * x[:, 0]).q, rows[0], atol=1e-14)


def test_one_place_that_is_too_fast_does_not_slow_down_the_others(rig, way):
    """Eight legs from rest to rest, one of them too quick."""
    ends = [rig.home + s * way for s in (0.0, 0.5, 0.1, 0.6, 0.2, 0.5, 0.0, 0.4)]
    times = np.cumsum([3.0, 3.0, 3.0, 0.3, 3.0, 3.0, 3.0])
    zero = np.zeros((7, 9))
    goal, trajectory, _ = follow(rig, times, np.array(ends[1:]), zero, zero)
    assert rig.code(goal) is None
    late = [trajectory.asked_time(t) for t in (9.0, 9.3)]
    assert late[0] == pytest.approx(9.0, abs=1e-9)
    assert late[1] < 9.2
    for k in (3, 4, 5, 6):
        behind = trajectory.duration - times[-1] + times[k]
        np.testing.assert_allclose(trajectory.at(behind).q, ends[k + 1], atol=1e-9)
    check_limits(rig, trajectory)


def test_a_corner_where_the_arm_rests_stays_a_corner(rig, way, config):
    turned = way * [1, -1, 1, -1, 1, -1, 1, -1, 1]
    q = rig.home + np.array([0.3 * way, 0.3 * way + 0.2 * turned])
    goal, trajectory, _ = follow(rig, [0.8, 1.5], q, np.zeros((2, 9)))
    assert rig.code(goal) is None
    at = trajectory.points.index(1)
    np.testing.assert_allclose(trajectory.at(float(trajectory.edges[at])).q, q[0], atol=1e-9)
    check_limits(rig, trajectory)
    check_executed(rig, config)


def test_one_joint_that_turns_round_reaches_where_it_turns(rig, config):
    q = np.tile(rig.home, (3, 1))
    q[:, 3] += [0.5, 0.1, 0.4]
    goal, trajectory, _ = follow(rig, [0.5, 1.0, 1.5], q)
    assert rig.code(goal) is None
    spline = CubicSpline([0.0, 0.5, 1.0, 1.5], [0.0, 0.5, 0.1, 0.4], bc_type="clamped")
    highest = spline(np.linspace(0.4, 0.7, 3001)).max()
    reached = trajectory.span(np.linspace(0.0, trajectory.duration, 20001)).q[:, 3].max()
    assert reached == pytest.approx(highest, abs=2e-3)
    check_limits(rig, trajectory)
    check_executed(rig, config)


def test_what_takes_over_from_a_motion_and_is_beyond_limits_begins_without_a_rest(rig, way, config):
    first = rig.move(rig.home + way)
    rig.ticks(120)
    end = rig.home + 0.2 * way
    second = rig.request({"kind": "trajectory", "points": points([0.3], end[None])}, policy="replace")
    rig.ticks(3)
    assert rig.code(first) == "replaced"
    assert rig.trace[-1].v.any()
    rig.run()
    assert rig.code(second) is None
    np.testing.assert_allclose(rig.trace[-1].q, end, atol=1e-9)
    rig.check_motion()
    check_executed(rig, config)


def test_a_pause_of_a_re_timed_trajectory_holds_on_its_path(rig, way, config):
    t, *rows = trapezoid(0.1, 0.5, way, rig.limits)
    goal = rig.request({"kind": "trajectory", "points": points(t, rig.home + rows[0], rows[1])})
    rig.ticks(150)
    rig.group.pause()
    rig.run()
    assert not rig.trace[-1].v.any()
    rig.group.resume()
    rig.run()
    assert rig.code(goal) is None
    off = rig.q - rig.home
    off -= (off @ way / (way @ way))[:, None] * way
    assert np.abs(off).max() < 1e-7
    check_executed(rig, config)


def test_a_setpoint_that_is_cut_ends_the_goal_and_is_caught_up_with(rig, way):
    """Judged is what was asked for: what limits leave of it is no success."""
    t, *rows = trapezoid(0.1, 0.3, way, rig.limits)
    goal = rig.request({"kind": "trajectory", "points": points(t, rig.home + rows[0], rows[1])})
    rig.ticks(150)
    asked = rig.group.planner.setpoint
    left = Setpoint(asked.q - 1e-3, asked.v, asked.a)
    rig.group.cut(left, ["left_j2"], rig.tick)
    assert rig.group.setpoint is left
    assert not rig.group.still
    rig.run()
    fault = rig.results[goal][0]
    assert fault.code == "limited"
    assert fault.facts["joint"] == "left_j2"
    assert f"left_j2 was cut to its limits at tick {150}" in fault.message
    assert not rig.group.setpoint.v.any()
    assert not rig.group.setpoint.a.any()


def test_tolerances_are_judged_against_what_was_asked_for(rig, way):
    """A setpoint that limits have moved away is an error, though the arm follows it."""
    t, *rows = trapezoid(0.1, 0.3, way, rig.limits)
    request = {"kind": "trajectory", "points": points(t, rig.home + rows[0], rows[1]), "path_tolerance": [0.002] * 9}
    goal = rig.request(request)
    rig.ticks(150)
    rig.error[4] = 0.003  # the arm is where the limits have left the setpoint
    rig.ticks(1)
    rig.error[:] = 0.0
    rig.run()
    assert rig.code(goal) == "path_tolerance"


def late_goal(rig, way, **tolerances):
    """A goal that is re-timed to 1.7 instead of 1.3 s; the time asked for."""
    t, *rows = trapezoid(0.1, 0.9, 1.2 * way, rig.limits)
    goal = rig.request({"kind": "trajectory", "points": points(t, rig.home + rows[0], rows[1]), **tolerances})
    return goal, float(t[-1])


@pytest.mark.parametrize(("allowed_s", "code"), [(1e-8, "goal_tolerance"), (0.1, "goal_tolerance"), (0.8, None)])
def test_who_comes_later_than_the_message_allows_has_missed_its_goal(rig, way, allowed_s, code):
    goal, asked_s = late_goal(rig, way, goal_time_tolerance=allowed_s)
    rig.run()
    assert rig.code(goal) == code
    if code:
        fault, results, _ = rig.results[goal]
        assert results["duration"] < asked_s + allowed_s + 0.5
        assert {"joint", "value", "limit"} <= set(fault.facts)
        assert re.search(r"beyond the goal tolerance [\d.]+ (m|rad)(/s)? 0\.[01]\d* s after the end", fault.message)
    else:
        assert "re-timed" in rig.results[goal][1]["retimed"]


def test_who_names_no_time_waits_for_what_is_re_timed(rig, way):
    goal, asked_s = late_goal(rig, way)
    rig.run()
    assert rig.code(goal) is None
    assert rig.results[goal][1]["duration"] > asked_s


@pytest.mark.parametrize(("tolerance", "code"), [(5e-4, "path_tolerance"), (0.0, None), (-1.0, None)])
def test_a_path_tolerance_holds_against_the_message_in_its_time(rig, way, tolerance, code):
    """What is re-timed is behind it; the default is a bound of the following error, which says nothing of time."""
    goal, _ = late_goal(rig, way, path_tolerance=[tolerance] * 9)
    rig.run()
    assert rig.code(goal) == code
    if code:
        fault = rig.results[goal][0]
        assert abs(fault.facts["value"]) > fault.facts["limit"] == tolerance
        rig.check_motion()


def test_what_is_tracked_is_held_against_its_message_too(rig, way):
    for tolerances, code in (
        ({"goal_time_tolerance": 0.1}, "goal_tolerance"),
        ({"path_tolerance": [0.01] * 9}, "path_tolerance"),
    ):
        rig.move(rig.home + way)
        rig.ticks(120)
        hasty = {"kind": "trajectory", "points": points([0.3], rig.home[None] - 0.2 * way), **tolerances}
        goal = rig.request(hasty, policy="replace")
        rig.run()
        assert rig.code(goal) == code
        rig.move(rig.home)
        rig.run()


@pytest.mark.parametrize("period_s", PERIODS)
def test_splines_keep_their_limits_at_every_servo_period(make_rig, config, way, period_s):
    timed = config.at_period(period_s)
    rig = make_rig(divisor=timed.servo.planning_divisor, servo=timed.servo)
    t, *rows = trapezoid(0.1, 0.9, way, rig.limits)
    goal, trajectory, _ = follow(rig, t, rig.home + rows[0], rows[1])
    assert rig.code(goal) is None
    check_limits(rig, trajectory)
    check_executed(rig, timed)
    rig.check_motion(acceleration=1.001, jerk=1.001)


def test_a_long_trajectory_is_prepared_in_many_slices(rig, way):
    t = np.arange(1, 1001) * 0.01
    wave, speed = 0.1 * (1.0 - np.cos(0.4 * np.pi * t)), 0.04 * np.pi * np.sin(0.4 * np.pi * t)
    goal = rig.request(
        {"kind": "trajectory", "points": points(t, rig.home + wave[:, None] * way, speed[:, None] * way)}
    )
    while rig.group.planner.progress == 1.0 and goal not in rig.results:
        rig.ticks(1)
    assert goal not in rig.results
    assert rig.tick > 20


def test_where_nothing_may_be_re_timed_it_is_refused_with_the_facts(make_rig, refusing, way):
    rig = make_rig(planning=refusing)
    t, *rows = trapezoid(0.1, 0.5, way, rig.limits)
    goal = rig.request({"kind": "trajectory", "points": points(t, rig.home + rows[0], rows[1])})
    rig.run()
    fault = rig.results[goal][0]
    assert isinstance(fault, ImError)
    assert {"joint", "time", "value", "limit"} <= set(fault.facts)
    assert not rig.v.any()


@given(st.lists(st.integers(-9, 9), min_size=1, max_size=40), st.integers(0, 50))
def test_the_least_of_those_ahead(values, reach):
    found = least_ahead(np.array(values, dtype=float), reach)
    assert found.tolist() == [min(values[k : k + reach + 1]) for k in range(len(values))]


def test_what_is_too_quick_for_floating_point_numbers_is_refused(rig):
    """Seventy nanoseconds for a tenth of a radian, which two milliseconds go on with."""
    q = np.array([
        [-0.601275, 0.164362, 0.0, 0.0, 1.142411, -3.3, 0.0, 0.312765, 0.005902],
        [-0.601275, 0.488423, 0.0, 0.0, 1.142411, -3.3, 0.021483, 0.312822, 0.007156],
    ])  # fmt: skip
    v = np.zeros((2, 9))
    v[0] = [0.382718, -0.523978, -0.578193, 0.14462, -0.253009, 0.433229, 0.351547, 0.390119, -0.017372]
    with np.errstate(all="ignore"):
        goal, _, _ = follow(rig, [6.99881e-8, 1.97889e-3], q, v)
    assert rig.code(goal) == "data"


def test_what_ends_in_no_number_is_refused_by_point_and_time(rig, monkeypatch):
    monkeypatch.setattr(stretch, "excess", lambda coefficients, *_: np.full(len(coefficients), np.nan))
    q = np.tile(rig.home, (2, 1))
    q[:, 3] += [0.3, 0.6]
    goal, _, _ = follow(rig, [0.1, 0.2], q)
    assert "the trajectory is too fast to be re-timed on the way to point 1, at 0 s" in message(rig, goal)


def test_a_count_of_pieces_beyond_measure_is_said_shortly(rig):
    q = np.tile(rig.home, (2, 1))
    q[:, 3] += [0.1, 0.2]
    with np.errstate(all="ignore"):
        goal, _, _ = follow(rig, [1.0, 1.0 + 1e-9], q)
    assert re.search(r"re-timing needs \d\.\d+e\+\d+ pieces; at most 250000 are allowed$", message(rig, goal))


def message(rig, goal):
    return rig.results[goal][0].message
