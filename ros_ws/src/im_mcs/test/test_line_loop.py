"""Straight lines through the whole loop, over the loopback driver."""

import numpy as np
import pinocchio as pin


def test_a_line_is_followed_through_the_loop(bench, config, model, cell):
    """The wrist's setpoints are on the line at every tick, whatever the planning period."""
    bench.to_motion("left")
    first = cell.home[:9].copy()
    first[7] = 0.8
    assert bench.move("left", first)["success"]
    q = bench.mcs.measured.q.copy()
    q[:9] = first
    start = model.pose(q, "left_wrist")
    target = start.translation + np.array([0.0, 0.4, 0.0])
    pose = [*target.tolist(), *pin.Quaternion(start.rotation).coeffs().tolist()]
    group, off = bench.mcs.groups["left"], []

    def look():
        q[:9] = group.planner.setpoint.q
        place = model.pose(q, "left_wrist").translation - start.translation
        off.append(np.hypot(place[0], place[2]))

    path = {"kind": "line", "poses": [pose], "speed": 0.25, "blend": 0.0}
    reply = bench.ask("move", on_tick=look, group="left", path=path, policy="refuse", speed_scale=0.0)
    assert reply["success"], reply
    assert max(off) < 5e-5
    assert 1.85 < reply["results"]["duration"] < 2.6  # 0.4 m at 0.25 m/s, and preparing and settling
    beyond = {"kind": "line", "poses": [[0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 1.0]], "speed": 0.25, "blend": 0.0}
    before = bench.mcs.measured.q.copy()
    refused = bench.ask("move", group="left", path=beyond, policy="refuse", speed_scale=0.0)
    assert not refused["success"]
    assert refused["error"]["code"] == "unreachable"
    np.testing.assert_allclose(bench.mcs.measured.q, before, atol=1e-4)
