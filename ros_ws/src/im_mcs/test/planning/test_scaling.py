"""Pause, resume, speed and early ends: on the path, within limits."""

import numpy as np
import pytest

from im_core.errors import ImError
from im_mcs.planning.trajectories.profile import to_rest

FAULT = ImError("the motion was cancelled", code="cancelled")


def begin(rig, kind, way):
    """A motion of some kind, not yet under way."""
    ends = rig.home + way, rig.home + way * [1, 0, 1, 0, 1, 0, 1, 0, 1], rig.home + 0.2 * way
    if kind == "straight":
        return rig.move(ends[0])
    if kind == "corners":
        return rig.move(*ends, blend=0.1)
    points = [{"time": 1.6 * k, "positions": q.tolist()} for k, q in enumerate(ends, start=1)]
    return rig.request({"kind": "trajectory", "points": points})


def on_path(rig, trajectory, since):
    """Largest distance of setpoints from the path of a trajectory, to first order between samples of it."""
    path = trajectory.span(np.linspace(0.0, trajectory.duration, 4001)).q
    return max(_distance(q, path) for q in rig.q[since::5])


def _distance(q, path):
    """From the nearest piece: the path may come by again, and the nearest sample be of that time."""
    way = np.diff(path, axis=0)
    length = (way**2).sum(axis=1)
    share = np.clip(((q - path[:-1]) * way).sum(axis=1) / np.where(length > 0.0, length, 1.0), 0.0, 1.0)
    return np.abs(q - path[:-1] - share[:, None] * way).max(axis=1).min()


def stopped_after(rig, since):
    moving = np.flatnonzero(rig.v[since:].any(axis=1))
    return 0.0 if not moving.size else (moving[-1] + 1) * rig.period


@pytest.mark.parametrize("kind", ["straight", "corners", "spline"])
@pytest.mark.parametrize("ticks", [30, 90, 170, 250])
def test_cancelling_decelerates_on_the_path_and_within_limits(rig, way, kind, ticks):
    goal = begin(rig, kind, way)
    rig.ticks(ticks)
    trajectory, since = rig.group.planner.follower.trajectory, len(rig.trace)
    optimum = to_rest(rig.trace[-1], rig.limits).duration
    rig.group.cancel(goal, FAULT)
    rig.run()
    assert rig.code(goal) == "cancelled"
    assert on_path(rig, trajectory, since) < 1e-5
    rig.check_motion(acceleration=1.03)
    factor = 1.02 if kind == "straight" else 2.0
    assert stopped_after(rig, since) <= factor * optimum + 0.1


@pytest.mark.parametrize("kind", ["straight", "corners", "spline"])
@pytest.mark.parametrize("ticks", [40, 150, 260])
def test_a_pause_holds_on_the_path_and_goes_on_along_it(rig, way, kind, ticks):
    goal = begin(rig, kind, way)
    rig.ticks(ticks)
    trajectory = rig.group.planner.follower.trajectory
    rig.group.pause()
    rig.run()
    assert rig.group.paused
    assert goal not in rig.results
    assert rig.group.speed == 0.0
    assert not rig.trace[-1].v.any()
    where = rig.trace[-1].q
    rig.ticks(50)
    np.testing.assert_array_equal(rig.trace[-1].q, where)
    rig.group.resume()
    rig.run()
    assert rig.code(goal) is None
    np.testing.assert_allclose(rig.trace[-1].q, trajectory.at(trajectory.duration).q, atol=1e-9)
    assert on_path(rig, trajectory, 0) < 1e-5
    rig.check_motion(acceleration=1.06)


def test_a_cancel_while_paused_ends_at_once(rig, way):
    goal = rig.move(rig.home + way)
    rig.ticks(100)
    rig.group.pause()
    rig.ticks(400)
    rig.group.cancel(goal, FAULT)
    rig.ticks(1)
    assert rig.code(goal) == "cancelled"
    assert rig.group.goals == ()


def test_half_the_speed_takes_twice_the_time_on_the_same_path(make_rig, way):
    durations = []
    for speed in (1.0, 0.5):
        rig = make_rig()
        rig.group.set_speed(speed)
        goal = rig.move(rig.home + way)
        rig.ticks(5)
        trajectory = rig.group.planner.follower.trajectory
        rig.run()
        durations.append(trajectory.duration / speed)
        moving = np.flatnonzero(rig.v.any(axis=1))
        assert (moving[-1] - moving[0]) * rig.period == pytest.approx(durations[-1], abs=0.02)
        assert rig.code(goal) is None
        rig.check_motion()
    assert durations[1] == pytest.approx(2.0 * durations[0])


def test_speed_scale_of_a_move_override_and_ceiling_combine(rig, way):
    rig.move(rig.home + way, speed_scale=0.5)
    rig.group.set_speed(0.8)
    rig.ticks(100)
    assert rig.group.speed == pytest.approx(0.4)
    rig.group.rates.set_ceiling(0.2)
    rig.ticks(150)
    assert rig.group.speed == pytest.approx(0.2)
    rig.group.rates.set_ceiling(1.0)
    rig.group.set_speed(1.0)
    rig.ticks(200)
    assert rig.group.speed == pytest.approx(0.5)
    rig.run()
    rig.check_motion()


def test_scales_together_slow_down_no_further_than_one_alone(rig, way):
    rig.move(rig.home + way, speed_scale=0.01)
    rig.group.set_speed(0.01)
    rig.ticks(400)
    assert rig.group.speed == pytest.approx(0.01)
    rig.group.set_speed(1.0)
    rig.group.cancel(rig.group.goals[0].id, ImError("enough"))
    rig.run()
    rig.move(rig.home + way)
    rig.group.rates.set_ceiling(0.049)
    rig.ticks(400)
    assert rig.group.speed == pytest.approx(0.05)


def test_speed_may_change_all_the_time(rig, way):
    goal = rig.move(rig.home + way, rig.home, rig.home + 0.5 * way, blend=0.05)
    random = np.random.default_rng(8)
    while goal not in rig.results:
        rig.group.rates.set_ceiling(float(random.uniform(0.1, 1.0)))
        rig.ticks(int(random.integers(1, 40)))
    assert rig.code(goal) is None
    rig.check_motion(acceleration=1.03)


def test_a_protective_stop_is_resumed_within_patience(rig, way):
    goal = rig.move(rig.home + way)
    rig.ticks(100)
    trajectory = rig.group.planner.follower.trajectory
    stop = ImError("too close", code="collision")
    rig.group.protective_stop(stop)
    rig.ticks(600)
    assert rig.group.protective is stop
    assert rig.group.wants_time
    assert goal not in rig.results
    with pytest.raises(ImError, match=r"held by a protective stop \(too close\)"):
        rig.move(rig.home)
    rig.group.resume()
    rig.run()
    assert rig.code(goal) is None
    assert on_path(rig, trajectory, 0) < 1e-5
    rig.check_motion(acceleration=1.06)


def test_goals_end_with_the_fault_when_patience_is_over_and_a_new_move_is_taken(rig, way):
    goal = rig.move(rig.home + way)
    waiting = rig.move(rig.home, policy="append")
    rig.ticks(100)
    rig.group.protective_stop(ImError("too close", code="collision"))
    since = rig.tick
    rig.run()
    assert rig.code(goal) == rig.code(waiting) == "collision"
    assert (rig.results[goal][2] - since) * rig.period == pytest.approx(
        rig.context.config.protective.patience_s, abs=0.01
    )
    assert rig.group.protective is None
    assert rig.code(_moved(rig, rig.home)) is None


def _moved(rig, q):
    goal = rig.move(q)
    rig.run()
    return goal


def test_a_protective_stop_without_goals_holds_nothing(rig, way):
    rig.group.protective_stop(ImError("too close", code="collision"))
    assert rig.group.protective is None
    assert rig.code(_moved(rig, rig.home + 0.1 * way)) is None


def test_a_protective_stop_that_was_asked_for_holds_until_it_is_resumed(rig, way):
    for goals in (False, True):
        goal = rig.move(rig.home + way) if goals else 0
        rig.ticks(100)
        stop = ImError("somebody comes", code="protective_stop")
        rig.group.protective_stop(stop, latched=True)
        rig.run()  # longer than the patience with suspended goals
        assert rig.group.protective is stop
        assert not goals or rig.code(goal) == "protective_stop"
        for policy in ("refuse", "append", "replace"):
            with pytest.raises(ImError, match=r"held by a protective stop \(somebody comes\); resume it$"):
                rig.move(rig.home, policy=policy)
        rig.group.resume()
        assert rig.group.protective is None
        assert rig.code(_moved(rig, rig.home)) is None


@pytest.mark.parametrize("kind", ["straight", "corners", "spline"])
@pytest.mark.parametrize("divisor", [2, 5])
def test_what_is_prepared_while_nothing_waits_for_it_changes_no_setpoint(make_rig, way, kind, divisor):
    rng = np.random.default_rng(divisor)
    stretches = [(int(rng.integers(1, 40)), rng.choice([0.0, 1.0, 1.0, rng.uniform(0.2, 1.0)])) for _ in range(60)]
    plain, ahead = make_rig(divisor), make_rig(divisor)
    for rig in (plain, ahead):
        begin(rig, kind, way)
        for ticks, speed in [*stretches, (5000, 1.0)]:
            if speed > 0.0:
                rig.group.set_speed(speed)
                rig.group.resume()
            else:
                rig.group.pause()
            for _ in range(ticks):
                rig.ticks(1)
                for _ in range(int(rng.integers(0, 3)) if rig is ahead else 0):
                    rig.group.planner.look_ahead()
    assert [plain.code(goal) for goal in plain.results] == [ahead.code(goal) for goal in ahead.results] == [None]
    for before, after in ((plain.q, ahead.q), (plain.v, ahead.v), (plain.a, ahead.a)):
        np.testing.assert_array_equal(before, after)


def test_at_no_speed_a_motion_halts_on_its_path_until_there_is_some(rig, way):
    goal = rig.move(rig.home + way)
    rig.ticks(60)
    rig.group.set_speed(0.0)
    rig.run()
    assert (rig.group.paused, rig.group.speed, goal in rig.results) == (True, 0.0, False)
    assert 0.01 < np.abs(rig.trace[-1].q - rig.home).max() < np.abs(way).max()
    rig.group.set_speed(1.0)
    rig.run()
    assert rig.code(goal) is None
    np.testing.assert_allclose(rig.trace[-1].q, rig.home + way, atol=1e-9)
    rig.check_motion()
