"""Jogs in the whole loop: the collision watch slows them down and stops them, and the status says so."""

import numpy as np
import pytest

from im_mcs.planning.motions.jog import JogLimit

DOWN = [0.0, 0.0, -0.2, 0.0, 0.0, 0.0]


@pytest.fixture
def left(bench):
    """The left group, in motion."""
    bench.to_motion("left")
    return bench.mcs.groups["left"]


def jog(bench, velocities, kind="twist", lease_s=0.3, **more):
    frame = {"frame": "world"} if kind == "twist" else {}
    return bench.send("stream", group="left", kind=kind, velocities=velocities, lease_s=lease_s, **frame, **more)


def until_still(bench, left, velocities, count=40):
    """Jog on and on; what has limited it."""
    told = []
    for _ in range(count):
        jog(bench, velocities)
        for _ in range(30):
            bench.mcs.tick([])
        told.append(left.jog_limit)
        if left.protective is not None or (told[-1] in (JogLimit.SINGULARITY, JogLimit.JOINT_RANGE) and left.still):
            break
    return told


def test_bodies_that_come_close_slow_a_jog_down_then_stop_it_and_it_comes_back(bench, left):
    """Tilted over, the left arm comes down on the table or another body before its joints are at their ends."""
    q = bench.mcs.measured.q[:9].copy()
    q[3:] = 0.7, 1.08, -3.0, 0.26, -0.79, -0.94
    reply = bench.move("left", q)
    assert reply["success"], reply
    told = until_still(bench, left, DOWN)
    assert JogLimit.COLLISION_AHEAD in told
    assert told[-1] is JogLimit.COLLISION
    assert left.protective.code == "collision"
    for _ in range(600):  # silence: the goal ends, and so does the stop
        bench.mcs.tick([])
    assert left.protective is None
    assert not left.goals
    stopped = bench.mcs.measured.q.copy()
    away = [-x for x in DOWN]
    for _ in range(5):
        jog(bench, away)
        for _ in range(30):
            bench.mcs.tick([])
    assert left.jog_limit in (JogLimit.NONE, JogLimit.COLLISION_AHEAD)
    assert np.abs(bench.mcs.measured.q - stopped).max() > 0.02
    assert bench.mcs.loop.proximity.distance > bench.mcs.config.collision.stop_m


def test_a_jog_ends_with_its_group_and_never_outlives_an_emergency_stop(bench, left):
    number = jog(bench, [0.0] * 8 + [0.2], kind="jog", lease_s=5.0)
    for _ in range(50):
        bench.mcs.tick([])
    bench.ask("estop", reason="enough")
    assert bench.reply(number)["error"]["message"] == "enough"
    assert not bench.mcs.tau.any()
    refused = jog(bench, [0.0] * 8 + [0.2], kind="jog")
    assert "stream of group 'left' is refused in state estopped" in bench.reply(refused)["error"]["message"]


def test_a_jog_does_not_take_over_from_torques_nor_a_path(bench, left):
    bench.send("stream", group="left", kind="torque", torques=bench.mcs.tau[:9].tolist(), lease_s=0.1)
    refused = jog(bench, [0.0] * 9, kind="jog")
    assert "driven by torques" in bench.reply(refused)["error"]["message"]
    bench.ask("pause")
    for _ in range(300):
        bench.mcs.tick([])
    bench.ask("resume")
    moving = bench.send(
        "move", group="left", path={"kind": "joint", "points": [(bench.mcs.measured.q[:9] + 0.1).tolist()]}
    )
    refused = jog(bench, [0.0] * 9, kind="jog")
    assert f"is moving (goal {moving})" in bench.reply(refused)["error"]["message"]
