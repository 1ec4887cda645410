"""Questions for a trajectory's state at a time: the setpoint of that tick, or the reason why there is none."""

import numpy as np
import pytest

from im_mcs.protocol.points import TimedPoints, pack_points


@pytest.fixture
def ask(bench):
    """A left arm in motion; ``ask(ticks)`` for the state so many ticks ahead."""
    bench.to_motion("left")

    def ask(ticks):
        stamp_ns = bench.mcs.measured.stamp_ns + round((ticks + 1) * 1e9 * bench.mcs.config.servo.period_s)
        return bench.reply(bench.send("query", group="left", stamp_ns=stamp_ns))

    return ask


def setpoints(bench, ticks):
    """Setpoints of the left arm in the next ticks, shape (ticks, 3, 9)."""
    seen = []
    for _ in range(ticks):
        bench.mcs.tick([])
        seen.append(bench.mcs.setpoint[:, :9].copy())
    return np.array(seen)


def check(reply, setpoint):
    assert reply["success"], reply
    for name, values, near in zip("qva", setpoint, (1e-9, 1e-9, 1e-6), strict=True):
        np.testing.assert_allclose(reply["results"][name], values, atol=near)


def move(bench, cell, kind):
    start, far = cell.home[:9], cell.home[:9] + 0.2
    if kind == "joint":
        return bench.send("move", group="left", path={"kind": "joint", "points": [far.tolist(), start.tolist()]})
    points = TimedPoints(np.array([2.0, 4.0]), np.array([far, start]), None, None)
    return bench.send("move", group="left", path={"kind": "trajectory", "points": pack_points(points)})


@pytest.mark.parametrize("kind", ["joint", "trajectory"])
@pytest.mark.parametrize("odd", [0, 1])
def test_the_answer_is_the_setpoint_that_comes_then_or_came(bench, ask, cell, kind, odd):
    move(bench, cell, kind)
    before = setpoints(bench, 60 + odd)
    check(ask(0), bench.mcs.setpoint[:, :9])
    check(ask(-21), before[-20])  # the questions took a tick each
    ahead = ask(50)
    check(ahead, setpoints(bench, 50)[-1])


def test_at_half_the_speed_it_is_where_the_arm_will_be_at_half_the_speed(bench, ask, cell):
    bench.send("set_speed", group="left", scale=0.5)
    move(bench, cell, "joint")
    setpoints(bench, 60)
    check(ask(50), setpoints(bench, 50)[-1])


def test_there_is_no_state_before_a_trajectory_and_behind_it_and_without_one(bench, ask, cell):
    assert "no trajectory is followed" in ask(0)["error"]["message"]
    goal = move(bench, cell, "joint")
    setpoints(bench, 60)
    assert "which goes from 0 to" in ask(-100)["error"]["message"]
    assert "which goes from 0 to" in ask(100_000)["error"]["message"]
    bench.send("cancel", goal=goal)
    setpoints(bench, 3)
    assert "leaves its trajectory: the motion was cancelled" in ask(0)["error"]["message"]
    assert not bench.ask("renew", owner="nobody")["success"]  # until it rests
    assert "no trajectory is followed" in ask(-5)["error"]["message"]
