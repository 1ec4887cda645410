"""Goals as MoveIt's time-optimal parametrisation makes them, given up on as MoveIt does at its defaults."""

import numpy as np
import pytest

ALLOWED, MARGIN_S = 1.2, 0.5
"""MoveIt cancels a goal after so many times its duration, and so much more."""
STEP_S = 0.1
"""Between the points that it sends [s]."""


def trapezoid(way, limits, share):
    """Times, and the shares of a straight way that are covered, with two derivatives: as fast as limits allow."""
    speed, force = (share * (limit / np.abs(way)).min() for limit in (limits.velocity, limits.acceleration))
    speed = min(speed, np.sqrt(force))
    ramp, end = speed / force, 1.0 / speed + speed / force
    t = np.append(np.arange(0.0, end - 1e-3, STEP_S), end)
    covered = np.where(t < ramp, 0.5 * force * t**2, 0.5 * speed * ramp + speed * (t - ramp))
    covered = np.where(t > end - ramp, 1.0 - 0.5 * force * (end - t) ** 2, covered)
    change = np.where(t < ramp, force, np.where(t > end - ramp, -force, 0.0))
    return t, (covered, force * np.minimum(np.minimum(t, ramp), end - t), change)


def run(rig, way, share):
    """Follow a goal along a way; returns its duration, when it began and when it ended, from its arrival on [s]."""
    t, rows = trapezoid(way, rig.limits, share)
    names = ("positions", "velocities", "accelerations")
    offsets = (rig.home, 0.0, 0.0)
    points = [
        {"time": float(time)}
        | {name: (off + row[k] * way).tolist() for name, off, row in zip(names, offsets, rows, strict=True)}
        for k, time in enumerate(t)
    ]
    goal, asked = rig.request({"kind": "trajectory", "points": points}, policy="replace"), rig.tick
    began = None
    while goal not in rig.results:
        rig.ticks(1)
        if began is None and rig.trace[-1].a.any():
            began = rig.tick - asked
    assert rig.code(goal) is None
    assert "re-timed" in rig.results[goal][1]["retimed"]
    rig.check_motion(acceleration=1.001, jerk=1.001)
    return float(t[-1]), began * rig.period, (rig.results[goal][2] - asked) * rig.period


@pytest.mark.parametrize(("share", "count", "cancelled"), [(0.1, 8, 0), (0.2, 8, 0), (0.5, 20, 0), (1.0, 10, 2)])
def test_short_motions_are_not_given_up_on(make_rig, share, count, cancelled):
    random, late = np.random.default_rng(5), 0
    for _ in range(count):
        way = random.uniform(-1.0, 1.0, 9) * random.choice([0.02, 0.05, 0.1, 0.2]) * [1, 1, 1, 2, 2, 2, 2, 2, 2]
        asked_s, began_s, ended_s = run(make_rig(), way, share)
        late += ended_s > ALLOWED * asked_s + MARGIN_S
        assert began_s <= (0.03 if asked_s < 2.0 else 0.07)
    assert late <= cancelled
