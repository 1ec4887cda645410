"""Trajectories that replace each other many times a second: the newest one is followed, from the next knot on."""

import numpy as np
import pytest

from im_core.errors import ImError
from im_mcs.planning.trajectories.interpolation import smooth
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial, quintic

CANCELLED = ImError("the motion was cancelled", code="cancelled")
SIZE, PACE = 0.3, 1.0


def to_come(rig, way, t, ahead_s, *, velocities):
    """Two points of a sine along ``way``, as a client sends that plans anew all the time: the last one at rest."""
    times = np.array([ahead_s, 2.0 * ahead_s])
    q = rig.home + (SIZE * np.sin(PACE * (t + times)))[:, None] * way
    speed = np.array([SIZE * PACE * np.cos(PACE * (t + ahead_s)), 0.0])[:, None] * way
    points = [{"time": time, "positions": row} for time, row in zip(times.tolist(), q.tolist(), strict=True)]
    for point, row in zip(points, speed.tolist(), strict=True):
        point |= {"velocities": row} if velocities else {}
    return {"kind": "trajectory", "points": points}


def replanned(rig, way, rate_hz, ahead_s, seconds, **kind):
    """Let a client plan anew for some seconds; its goals."""
    goals, due = [], 0
    for tick in range(round(seconds / rig.period)):
        if tick * rig.period >= due / rate_hz:
            goals.append(rig.request(to_come(rig, way, tick * rig.period, ahead_s, **kind), policy="replace"))
            due += 1
        rig.ticks(1)
    return goals


@pytest.mark.parametrize("velocities", [True, False])
@pytest.mark.parametrize(("rate_hz", "ahead_s"), [(10, 0.3), (30, 0.1), (30, 0.5), (111, 0.1)])
def test_who_plans_anew_is_followed(rig, way, rate_hz, ahead_s, velocities):
    goals = replanned(rig, way, rate_hz, ahead_s, 8.0, velocities=velocities)
    assert {rig.code(goal) for goal in goals[:-1]} == {"replaced"}
    t = np.arange(len(rig.trace)) * rig.period
    behind = (t > 1.5) & (t < 8.0)
    place = (rig.q - rig.home) @ way / (way @ way)
    lags = np.arange(0.0, 0.1, 0.005)
    errors = [np.abs(place - SIZE * np.sin(PACE * (t - lag)))[behind].max() for lag in lags]
    assert lags[int(np.argmin(errors))] <= 0.06
    assert min(errors) < 0.02  # the stops that are asked for within 0.1 s are none that limits allow
    rig.check_motion(jerk=1.1)
    rig.run()
    assert rig.code(goals[-1]) is None


def test_what_is_replaced_ends_on_arrival_and_the_next_move_begins_at_once(rig, way):
    goals = []
    for k in range(30):
        goals.append(rig.request(to_come(rig, way, 0.1 * k, 0.3, velocities=True), policy="replace"))
        rig.ticks(1)
    assert [rig.code(goal) for goal in goals[:-2]] == ["replaced"] * 28
    move = rig.move(rig.home, policy="replace")
    rig.ticks(6)
    assert rig.group.goals[0].id == move
    assert rig.code(goals[-1]) == "replaced"
    rig.run()
    assert rig.code(move) is None
    rig.check_motion()


def test_many_at_once_leave_the_newest(rig, way):
    goals = [rig.request(to_come(rig, way, 0.1 * k, 0.3, velocities=True), policy="replace") for k in range(30)]
    rig.ticks(6)
    assert rig.trace[-1].v.any()
    assert [rig.code(goal) for goal in goals[:-1]] == ["replaced"] * 29
    rig.run()
    assert rig.code(goals[-1]) is None
    np.testing.assert_allclose(rig.trace[-1].q, rig.home + SIZE * np.sin(PACE * (2.9 + 0.6)) * way, atol=1e-9)


def test_what_keeps_limits_is_followed_in_time_and_on_its_path(rig, way):
    rig.move(rig.home + way)
    rig.ticks(150)
    ends = ((3.5, 0.8), (6.0, 0.1))
    points = [{"time": t, "positions": (rig.home + s * way).tolist()} for t, s in ends]
    goal = rig.request({"kind": "trajectory", "points": points}, policy="replace")
    while rig.group.goals[0].id != goal:
        begin = len(rig.trace) - 1
        rig.ticks(1)
    rig.run()
    assert rig.code(goal) is None
    wanted = _spline(rig.trace[begin], ends, rig.home, way).span(rig.period * np.arange(len(rig.trace) - begin)).q
    assert np.abs(rig.q[begin:] - wanted).max() < 2e-4


def _spline(start, ends, home, way):
    """The natural continuation of a motion through places along a way, at rest in the last one."""
    h = np.diff([0.0, *(t for t, _ in ends)])
    q = np.vstack([start.q, *(home + s * way for _, s in ends)])
    return PiecewisePolynomial(h, quintic(h, q, *smooth(h, q, start.v, start.a)))


@pytest.mark.parametrize("act", ["pause", "cancel", "slow"])
def test_it_halts_on_the_path_and_goes_on(rig, way, act):
    rig.move(rig.home + way)
    rig.ticks(150)
    points = [{"time": 3.5, "positions": (rig.home + 0.8 * way).tolist()}]
    goal = rig.request({"kind": "trajectory", "points": points}, policy="replace")
    rig.ticks(60)
    if act == "cancel":
        rig.group.cancel(goal, CANCELLED)
    elif act == "pause":
        rig.group.pause()
    else:
        rig.group.set_speed(0.3)
    rig.run()
    if act == "pause":
        assert not rig.trace[-1].v.any()
        assert goal not in rig.results
        rig.group.resume()
        rig.run()
    assert rig.code(goal) == ("cancelled" if act == "cancel" else None)
    off = rig.q - rig.home
    off -= (off @ way / (way @ way))[:, None] * way
    assert np.abs(off).max() < 2e-3
    rig.check_motion(jerk=1.1)


def test_what_must_not_be_late_is_refused_on_the_move_too(make_rig, refusing, way):
    rig = make_rig(planning=refusing)
    first = rig.move(rig.home + way)
    rig.ticks(120)
    second = rig.request(to_come(rig, way, 0.0, 0.1, velocities=True), policy="replace")
    rig.run()
    assert (rig.code(first), rig.code(second)) == (None, "limit")
