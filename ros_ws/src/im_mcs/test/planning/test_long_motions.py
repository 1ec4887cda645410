"""Motions that take long: prepared at a bounded cost, or refused; nothing that a client asks for ends the servo."""

import time

import numpy as np
import pinocchio as pin
import pytest

from im_mcs.planning.line.line import LinePreparation

TICK_S = 0.2
WAY_M = 0.05


@pytest.fixture
def bent(rig):
    """A group whose arm is well bent."""
    rig.home = rig.home.copy()
    rig.home[7] = 0.8
    rig.move(rig.home)
    rig.run()
    return rig


def line(rig, speed, poses=1, **more):
    """A path of the wrist to and fro along one line, or a little off it."""
    here = rig.context.model.pose(rig.q_all, "left_wrist")
    turn = pin.Quaternion(here.rotation).coeffs().tolist()
    steps = [[0.0, WAY_M * (k % 2 == 0), -0.03 * (k % 4 > 1)] for k in range(poses)]
    return {"kind": "line", "poses": [[*(here.translation + s), *turn] for s in steps], "speed": speed, **more}


def there_and_back(rig, seconds):
    """Two points at rest, the second of which is far off in time; where they join the acceleration jumps."""
    there = rig.home.copy()
    there[3] += 0.3
    points = [
        {"time": t, "positions": q.tolist(), "velocities": [0.0] * 9} for t, q in ((1.5, there), (seconds, rig.home))
    ]
    return {"kind": "trajectory", "points": points}


def wave(rig, seconds):
    """Far too quick to and fro, with a point every tenth of a second."""
    t = np.arange(0.1, seconds, 0.1)
    joints = [0, 0, 0, 1, 1, 1, 1, 1, 1]
    q = rig.home + np.outer(0.05 * np.sin(t) + 0.01 * np.sin(40.0 * t), joints)
    v = np.outer(0.05 * np.cos(t) + 0.4 * np.cos(40.0 * t), joints)
    v[-1] = 0.0
    rows = zip(t.tolist(), q.tolist(), v.tolist(), strict=True)
    points = [{"time": x, "positions": at, "velocities": speed} for x, at, speed in rows]
    return {"kind": "trajectory", "points": points}


def prepared(rig, path):
    """Ask for a motion and wait until it begins or is refused: its number, the trajectory, the longest tick [s]."""
    before, longest = rig.group.planner.follower, 0.0
    goal = rig.request(path)
    while rig.group.planner.follower is before and goal not in rig.results:
        began = time.thread_time()
        rig.ticks(1)
        longest = max(longest, time.thread_time() - began)
    return goal, getattr(rig.group.planner.follower, "trajectory", None), longest


@pytest.mark.parametrize("speed", [1e-2, 1e-3, 1e-4])
def test_a_slow_line_is_kept_with_few_pieces(bent, model, speed):
    begin = model.pose(bent.q_all, "left_wrist").translation
    _, trajectory, longest = prepared(bent, line(bent, speed))
    assert trajectory.duration == pytest.approx(WAY_M / speed, rel=0.02)
    assert len(trajectory.lengths) < 100
    assert longest < TICK_S
    whole = bent.q_all.copy()
    for q in trajectory.span(np.linspace(0.0, trajectory.duration, 500)).q:
        whole[bent.index] = q
        off = model.pose(whole, "left_wrist").translation - begin
        assert np.linalg.norm(off[[0, 2]]) < 2e-5


def test_many_lines_with_rounded_corners_cost_no_long_tick(bent):
    _, trajectory, longest = prepared(bent, line(bent, 0.0, poses=40, blend=0.01))
    assert len(set(trajectory.points)) == 40
    assert longest < TICK_S


@pytest.mark.parametrize("speed", [1e-6, 1e-9])
def test_a_line_that_never_seems_to_end_is_refused(bent, speed):
    goal, _, longest = prepared(bent, line(bent, speed))
    fault = bent.results[goal][0]
    assert fault.message == (
        f"a line of 0.05 m at {speed:.4g} m/s takes {WAY_M / speed:.4g} s; up to 10000 s may lie between two rests"
    )
    assert longest < TICK_S
    bent.move(bent.home + 0.01)
    bent.run()
    assert bent.code(goal + 1) is None


@pytest.mark.parametrize("seconds", [600.0, 1e4, 1e6])
def test_a_long_piece_is_retimed_at_a_bounded_cost(rig, seconds):
    goal, trajectory, longest = prepared(rig, there_and_back(rig, seconds))
    assert goal not in rig.results
    assert seconds <= trajectory.duration < seconds + 1.0
    assert longest < TICK_S
    t = np.unique(np.concatenate([np.linspace(0.0, 4.0, 4000), np.linspace(0.0, trajectory.duration, 4000)]))
    s = trajectory.span(t)
    assert (np.abs(s.v) <= rig.limits.velocity).all()
    assert (np.abs(s.a) <= rig.limits.acceleration).all()
    assert s.q[-1] == pytest.approx(rig.home)


def test_what_would_be_retimed_without_end_is_refused(make_rig, monkeypatch):
    monkeypatch.setattr("im_mcs.planning.retiming.stretch.MOST_PIECES", 1000)
    rig = make_rig()
    goal, _, _ = prepared(rig, wave(rig, 60.0))
    fault = rig.results[goal][0]
    assert fault.code == "data"
    assert "a stretch of 59.9 s is beyond limits, and its re-timing needs 1" in fault.message
    assert fault.message.endswith("at most 1000 are allowed")


def test_the_cells_of_a_path_are_bounded(make_rig, monkeypatch):
    monkeypatch.setattr("im_mcs.planning.retiming.asked_path._MOST_IN_ALL", 5000)
    rig = make_rig()
    goal, _, _ = prepared(rig, wave(rig, 60.0))
    fault = rig.results[goal][0]
    assert fault.facts["value"] > fault.facts["limit"] == 5000
    assert f"its re-timing needs {fault.facts['value']} cells; at most 5000 are allowed" in fault.message


def test_a_motion_that_cannot_be_planned_ends_alone(rig, monkeypatch):
    def fails(self):
        raise MemoryError("no room")

    monkeypatch.setattr(LinePreparation, "step", fails)
    first = rig.move(rig.home + 0.1)
    rig.ticks(20)
    goal = rig.request(line(rig, 0.1), policy="append")
    rig.run()
    assert rig.code(first) is None
    assert rig.code(goal) == "internal"
    assert "group 'left': the motion cannot be planned: MemoryError('no room')" in rig.results[goal][0].message
