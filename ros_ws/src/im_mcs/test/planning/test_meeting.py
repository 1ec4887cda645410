"""Streams as moveit_servo sends them, targets for now, velocities at the end: followed, and rest behind them."""

import numpy as np
import pytest

from im_core.errors import LimitError

AHEAD_S, RATE_HZ = 0.1, 30.0


def ask(rig, time, q, v=None, **more):
    point = {"time": time, "positions": q.tolist()} | ({} if v is None else {"velocities": v.tolist()})
    return rig.request({"kind": "trajectory", "points": [point], "may_be_late": True} | more, policy="replace")


def stream(rig, course, seconds, *, velocities=True, late_s=0.0):
    """Send where a course, which gives q and v at a time, will be; returns how far off it the setpoint was, by tick."""
    off, sent = [], 0
    random = np.random.default_rng(3)
    while (now := rig.tick * rig.period) < seconds:
        if now * RATE_HZ >= sent:
            q, v = course(now + AHEAD_S + late_s * random.standard_normal())
            ask(rig, AHEAD_S, q, v if velocities else None)
            sent += 1
        rig.ticks(1)
        off.append(rig.trace[-1].q - course(rig.tick * rig.period)[0])
    return np.array(off)


def ramp(rig, way, speed=0.2):
    return lambda t: (rig.home + speed * t * way, speed * way)


def swing(rig, way, size=0.2, pace=1.0):
    return lambda t: (rig.home + size * way * (1.0 - np.cos(pace * t)), size * pace * way * np.sin(pace * t))


def at_rest_in_the_end(rig):
    rig.run()
    assert not rig.trace[-1].v.any()
    assert not rig.trace[-1].a.any()
    return rig.trace[-1].q


@pytest.mark.parametrize("late_s", [0.0, 0.002])
def test_a_stream_along_a_ramp_is_caught_up_with_and_followed(rig, way, late_s):
    off = stream(rig, ramp(rig, way), 3.0, late_s=late_s)
    speed = 0.2 * np.abs(way).max()
    assert np.abs(off).max() < speed * 0.15  # from rest: behind by no more than 0.15 s
    assert np.abs(off[222:]).max() < speed * (2.0 * rig.context.period_s + 4.0 * late_s)  # after a second
    before = rig.trace[-1].q
    end = at_rest_in_the_end(rig)
    assert (np.abs(end - before) < speed * 0.5).all()
    rig.check_motion(jerk=1.6)
    assert {rig.code(goal) for goal in rig.results} == {"replaced", None}


@pytest.mark.parametrize(("size", "pace"), [(0.2, 1.0), (0.1, 2.0)])
def test_a_stream_along_a_sine_is_followed(rig, way, size, pace):
    off = stream(rig, swing(rig, way, size, pace), 6.0, late_s=0.001)
    assert np.abs(off / way).max() < 0.05 * size
    at_rest_in_the_end(rig)
    rig.check_motion(jerk=1.6)


def test_a_stream_of_positions_alone_lags_and_arrives(rig, way):
    off = stream(rig, ramp(rig, way), 2.0, velocities=False)
    assert np.abs(off / way).max() < 0.2 * 0.4
    np.testing.assert_allclose(at_rest_in_the_end(rig), ramp(rig, way)(1.98 + AHEAD_S)[0], atol=0.01)
    rig.check_motion(jerk=1.6)


def test_a_stream_that_ends_with_a_velocity_of_0_ends_in_its_last_point(rig, way):
    stream(rig, ramp(rig, way), 2.0)
    last = ramp(rig, way)(2.0)[0]
    goal = ask(rig, AHEAD_S, last, np.zeros(9))
    np.testing.assert_allclose(at_rest_in_the_end(rig), last, atol=1e-9)
    assert rig.code(goal) is None
    rig.check_motion(jerk=1.6)


def test_a_stream_towards_the_end_of_a_joint_is_refused_where_the_arm_could_not_stop(rig, way):
    edge, speed = rig.all_limits.upper[8], 2.0
    only = np.eye(9)[8]

    def course(t):
        return rig.home + np.clip(speed * t, 0.0, edge - 1e-3) * only, speed * only

    stream(rig, course, 3.0)
    refused = [fault for fault, _, _ in rig.results.values() if fault is not None and fault.code == "limit"]
    assert refused
    assert "left_j6: position at" in refused[0].message
    assert at_rest_in_the_end(rig)[8] < edge
    assert rig.q[:, 8].max() < edge


def test_one_point_at_time_0_is_gone_to_at_once(rig, way):
    for offset in (0.0, 1e-4, 0.2):
        goal = ask(rig, 0.0, rig.home + offset * way, may_be_late=False)
        np.testing.assert_allclose(at_rest_in_the_end(rig), rig.home + offset * way, atol=1e-9)
        assert rig.code(goal) is None
    rig.check_motion()


def test_behind_a_velocity_at_the_end_the_motion_decelerates_to_rest(rig, way):
    q, v = rig.home + 0.3 * way, 0.2 * way
    points = [
        {"time": 2.0, "positions": (rig.home + 0.15 * way).tolist(), "velocities": (0.15 * way).tolist()},
        {"time": 3.0, "positions": q.tolist(), "velocities": v.tolist()},
    ]
    for point in points:
        point["accelerations"] = [0.0] * 9
    goal = rig.request({"kind": "trajectory", "points": points})
    end = at_rest_in_the_end(rig)
    assert rig.code(goal) is None
    at = int(np.argmin(np.abs(rig.q - q).sum(axis=1)))
    np.testing.assert_allclose(rig.q[at], q, atol=2e-3)
    np.testing.assert_allclose(rig.v[at], v, atol=1e-2)
    assert (np.sign(end - q) == np.sign(v)).all()
    assert (np.abs(end - q) >= 0.5 * v**2 / rig.limits.acceleration).all()
    rig.check_motion()


def test_behind_a_velocity_at_the_end_there_must_be_room_to_stop(rig):
    q, v = rig.home.copy(), np.zeros(9)
    q[8], v[8] = rig.all_limits.upper[8] - 0.01, 2.0
    goal = rig.request(
        {"kind": "trajectory", "points": [{"time": 5.0, "positions": q.tolist(), "velocities": v.tolist()}]}
    )
    rig.ticks(50)
    fault = rig.results[goal][0]
    assert isinstance(fault, LimitError)
    assert "left_j6: position at" in fault.message
    assert not rig.trace[-1].v.any()
