"""Queue of motions: append, replace, refuse, cancel; whatever comes, the setpoint never leaps."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import ImError, StateError

CANCELLED = ImError("the motion was cancelled", code="cancelled")


def test_a_second_motion_is_refused(rig, way):
    goal = rig.move(rig.home + way)
    with pytest.raises(StateError, match=rf"'left' is moving \(goal {goal}\)"):
        rig.move(rig.home)
    rig.run()
    assert rig.code(goal) is None
    assert rig.results[goal][1]["duration"] == pytest.approx((rig.results[goal][2]) * rig.period, abs=0.02)


def test_appended_motions_follow_without_a_pause(rig, way):
    goals = [rig.move(rig.home + s * way, policy="append") for s in (0.5, 0.1, 0.4)]
    rig.run()
    assert [rig.code(goal) for goal in goals] == [None, None, None]
    ends = [rig.results[goal][2] for goal in goals]
    for goal, end, scale in zip(goals, ends, (0.5, 0.1, 0.4), strict=True):
        if goal != goals[-1]:
            assert np.abs(rig.q[end - 5 : end + 5] - rig.home - scale * way).max(axis=1).min() < 1e-9
    still = np.flatnonzero(~rig.v[: ends[-2]].any(axis=1))
    assert (still < 6).sum() + (np.abs(still[:, None] - ends).min(axis=1) < 6).sum() >= len(still)
    rig.check_motion()


@pytest.mark.parametrize("ticks", [31, 100, 180, 300])
@pytest.mark.parametrize("divisor", [1, 2, 3])
def test_a_replaced_motion_goes_over_to_the_next(make_rig, way, ticks, divisor):
    rig = make_rig(divisor)
    first = rig.move(rig.home + way)
    waiting = rig.move(rig.home, policy="append")
    rig.ticks(ticks)
    speed = np.abs(rig.trace[-1].v).max()
    second = rig.move(rig.home - 0.2 * way, rig.home, policy="replace")
    rig.ticks(6)
    assert rig.code(first) == rig.code(waiting) == "replaced"
    assert f"replaced by goal {second}" in rig.results[first][0].message
    assert np.abs(rig.trace[-1].v).max() > 0.5 * speed
    rig.run()
    assert rig.code(second) is None
    np.testing.assert_allclose(rig.trace[-1].q, rig.home, atol=1e-9)
    rig.check_motion()


def test_a_trajectory_replaces_a_motion_from_where_it_is(rig, way):
    first = rig.move(rig.home + way)
    rig.ticks(150)
    ends = ((3.5, 0.8), (6.0, 0.1))
    points = [{"time": t, "positions": (rig.home + s * way).tolist()} for t, s in ends]
    second = rig.request({"kind": "trajectory", "points": points}, policy="replace")
    rig.run()
    assert (rig.code(first), rig.code(second)) == ("replaced", None)
    rig.check_motion()


def test_a_replacement_that_is_refused_changes_nothing(make_rig, refusing, way):
    rig = make_rig(planning=refusing)
    first = rig.move(rig.home + way)
    rig.ticks(120)
    hasty = [{"time": 0.1, "positions": rig.home.tolist()}]
    second = rig.request({"kind": "trajectory", "points": hasty}, policy="replace")
    with pytest.raises(ImError):
        rig.move(rig.home + 100.0, policy="replace")
    rig.run()
    assert (rig.code(first), rig.code(second)) == (None, "limit")
    np.testing.assert_allclose(rig.trace[-1].q, rig.home + way, atol=1e-9)


def test_cancelling_ends_what_waits_behind_but_not_what_is_before(rig, way):
    goals = [rig.move(rig.home + s * way, policy="append") for s in (0.5, 0.1, 0.4)]
    rig.ticks(60)
    rig.group.cancel(goals[1], CANCELLED)
    rig.ticks(1)
    assert rig.code(goals[1]) == rig.code(goals[2]) == "cancelled"
    rig.run()
    assert rig.code(goals[0]) is None
    with pytest.raises(StateError, match=f"goal {goals[0]} is not under way"):
        rig.group.cancel(goals[0], CANCELLED)


def test_a_motion_appended_to_one_that_is_being_cancelled_begins_where_it_stops(rig, way):
    first = rig.move(rig.home + way)
    rig.ticks(150)
    rig.group.cancel(first, CANCELLED)
    second = rig.move(rig.home, policy="append")
    rig.run()
    assert (rig.code(first), rig.code(second)) == ("cancelled", None)
    np.testing.assert_allclose(rig.trace[-1].q, rig.home, atol=1e-9)
    rig.check_motion()


def test_two_hundred_points_are_prepared_over_many_ticks_and_always_the_same(make_rig):
    random = np.random.default_rng(0)
    traces = []
    for _ in range(2):
        rig = make_rig()
        points = [rig.home + x for x in np.random.default_rng(1).uniform(-0.05, 0.0, (200, 9))]
        rig.move(*points, blend=0.01)
        rig.ticks(30)
        assert not rig.v.any()
        while not rig.v.any():
            rig.ticks(1)
        rig.ticks(int(random.integers(300, 400)))
        traces.append(rig.q[:400])
    np.testing.assert_array_equal(*traces)


def test_progress_names_the_goal_and_its_point(rig, way):
    goal = rig.move(rig.home + 0.2 * way, rig.home)
    told = []
    while goal not in rig.results:
        rig.ticks(10)
        told.append(rig.group.progress())
    told = [t for t in told if t is not None]
    assert {t["id"] for t in told} == {goal}
    assert {t["point"] for t in told} == {0, 1}
    assert [t["progress"] for t in told] == sorted(t["progress"] for t in told)
    assert rig.group.progress() is None


def test_dropping_forgets_everything(rig, way):
    goals = [rig.move(rig.home + s * way, policy="append") for s in (0.5, 0.1)]
    rig.ticks(60)
    assert [goal.id for goal in rig.group.drop_goals()] == goals
    rig.group.disengage()
    assert rig.group.goals == ()
    assert not rig.group.wants_time
    rig.group.engage(rig.home)
    rig.ticks(3)
    np.testing.assert_array_equal(rig.trace[-1].q, rig.home)


ACTS = st.sampled_from(
    ["move", "corners", "trajectory", "stream", "cancel", "stop", "protective", "pause", "resume", "speed", "ceiling"]
)


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 3), st.lists(st.tuples(ACTS, st.integers(1, 180)), max_size=12), st.integers(0, 10**6))
def test_whatever_comes_the_setpoint_never_leaps(make_rig, way, divisor, acts, seed):
    rig, random = make_rig(divisor), np.random.default_rng(seed)
    asked = []
    for act, ticks in acts:
        with contextlib.suppress(StateError):
            asked.append(_act(rig, act, way, random))
        rig.ticks(ticks)
    rig.group.resume()
    rig.group.rates.set_ceiling(1.0)
    rig.run()
    assert rig.group.goals == ()
    assert set(rig.results) >= {goal for goal in asked if goal is not None}
    # a stop for which a trajectory leaves no room goes beyond the limit of acceleration by a little
    rig.check_motion(acceleration=1.15, jerk=2.0)


def _act(rig, act, way, random):
    policy = str(random.choice(["append", "replace", "refuse"]))
    points = [rig.home + way * random.uniform(-0.6, 0.9, 9) for _ in range(random.integers(1, 4))]
    group = rig.group
    match act:
        case "move" | "corners":
            return rig.move(*points, policy=policy, blend=0.2 if act == "corners" else 0.0)
        case "trajectory":
            times = np.cumsum(random.uniform(*random.choice([[2.0, 3.0], [0.1, 0.5]]), len(points)))
            given = [{"time": t, "positions": q.tolist()} for t, q in zip(times.tolist(), points, strict=True)]
            return rig.request({"kind": "trajectory", "points": given}, policy=policy)
        case "stream":
            rig.stream(points[0], lease_s=0.3)
        case "cancel" if group.goals:
            group.cancel(group.goals[-1].id, CANCELLED)
        case "stop":
            group.stop(CANCELLED)
        case "protective":
            group.protective_stop(CANCELLED)
        case "pause":
            group.pause()
        case "resume":
            group.resume()
        case "speed":
            group.set_speed(float(random.uniform(0.2, 1.0)))
        case "ceiling":
            group.rates.set_ceiling(float(random.uniform(0.05, 1.0)))
    return None
