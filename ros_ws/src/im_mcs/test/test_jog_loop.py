"""Jogs in the whole loop: the collision watch slows them down and stops them, and the status says so."""

import numpy as np
import pytest

from im_mcs.planning.motions.jog import JogLimit

DOWN = np.array([0.0, 0.0, 0.0, 0.77, -0.93, 0.67, 0.0, 0.0, 0.0])
"""From home it leads through the table."""


@pytest.fixture
def left(bench):
    """The left group, in motion."""
    bench.to_motion("left")
    return bench.mcs.groups["left"]


def jog(bench, velocities, lease_s=0.3):
    given = [float(v) for v in velocities]
    return bench.send("stream", group="left", kind="jog", velocities=given, lease_s=lease_s)


def test_bodies_that_come_close_slow_a_jog_down_then_stop_it_and_it_comes_back(bench, left):
    told, distance = [], np.inf
    for _ in range(60):
        jog(bench, 0.3 * DOWN)
        for _ in range(30):
            bench.mcs.tick([])
        told.append(left.jog_limit)
        distance = min(distance, bench.mcs.loop.proximity.distance)
        if left.protective is not None:
            break
    assert JogLimit.COLLISION_AHEAD in told
    assert told[-1] is JogLimit.COLLISION
    assert left.protective.code == "collision"
    for _ in range(600):  # silence: the goal ends, and so does the stop
        bench.mcs.tick([])
    assert left.protective is None
    assert not left.goals
    stopped = bench.mcs.measured.q.copy()
    for _ in range(5):
        jog(bench, -0.3 * DOWN)
        for _ in range(30):
            bench.mcs.tick([])
        distance = min(distance, bench.mcs.loop.proximity.distance)
    assert left.jog_limit in (JogLimit.NONE, JogLimit.COLLISION_AHEAD)
    assert np.abs(bench.mcs.measured.q - stopped).max() > 0.02
    assert distance > 0.0


def test_a_jog_ends_with_its_group_and_never_outlives_an_emergency_stop(bench, left):
    number = jog(bench, [0.0] * 8 + [0.2], lease_s=5.0)
    for _ in range(50):
        bench.mcs.tick([])
    bench.ask("estop", reason="enough")
    assert bench.reply(number)["error"]["message"] == "emergency stop: enough"
    assert not bench.mcs.tau.any()
    refused = jog(bench, [0.0] * 8 + [0.2])
    assert "stream is refused in state estopped" in bench.reply(refused)["error"]["message"]


def test_a_jog_does_not_take_over_from_torques_nor_a_path(bench, left):
    bench.send("stream", group="left", kind="torque", torques=bench.mcs.tau[:9].tolist(), lease_s=0.1)
    refused = jog(bench, [0.0] * 9)
    assert "driven by torques" in bench.reply(refused)["error"]["message"]
    bench.ask("pause")
    for _ in range(300):
        bench.mcs.tick([])
    bench.ask("resume")
    moving = bench.send(
        "move", group="left", path={"kind": "joint", "points": [(bench.mcs.measured.q[:9] + 0.1).tolist()]}
    )
    refused = jog(bench, [0.0] * 9)
    assert f"is moving (goal {moving})" in bench.reply(refused)["error"]["message"]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_at_full_speed_stops_at_its_end_before_the_limiter_has_to_cut(bench, left, sign):
    v = np.zeros(9)
    v[8] = sign * left.context.limits.motion.velocity[8]
    for _ in range(30):
        jog(bench, v)
        for _ in range(30):
            bench.mcs.tick([])
    assert left.jog_limit is JogLimit.JOINT_RANGE
    end = (left.context.limits.upper if sign > 0.0 else left.context.limits.lower)[8]
    assert bench.mcs.measured.q[8] == pytest.approx(end, abs=2e-3)
    assert not bench.mcs.saturations.counts.any()
