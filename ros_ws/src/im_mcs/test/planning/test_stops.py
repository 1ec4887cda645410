"""Stops on the path: as quick as limits allow where it is straight, within the monitor's bound where it is not."""

import numpy as np
import pytest

from im_mcs.collision.braking_distance import BrakingDistance
from im_mcs.planning.trajectories.straight_stop import is_straight

WAYS = ((0.7, 1.0), (1.4, -1.0), (2.1, 0.3), (2.4, 0.0))
DOWN = np.array([0.2, 0.1, 0.05, 0.77, -0.93, 0.67, 0.4, -0.3, 0.5])
REACTION_S = 0.018


def start(rig, kind, seed):
    """Begin a motion through points beside a line."""
    aside = np.random.default_rng(seed).uniform(-0.3, 0.3, 9) * np.array([0.3, 0.5, 0.2, 1, 1, 1, 1, 1, 1])
    points = [rig.home + share * DOWN + swing * aside for share, swing in WAYS]
    if kind == "spline":
        timed = [{"time": 1.3 * (k + 1), "positions": point.tolist()} for k, point in enumerate(points)]
        timed = [{**point, "velocities": [], "accelerations": []} for point in timed]
        tolerances = {"path_tolerance": [], "goal_tolerance": [], "goal_time_tolerance": 0.0}
        rig.request({"kind": "trajectory", "points": timed, **tolerances})
    else:
        rig.move(*points, blend=0.2 if kind == "corners" else 0.0)
    while not rig.group.planner.setpoint.v.any():
        rig.ticks(1)


def halt(rig):
    """Pause and wait for the rest; how long it took [s]."""
    before = rig.tick
    rig.group.pause()
    while not rig.group.planner.still:
        rig.ticks(1)
    return (rig.tick - before) * rig.period


@pytest.mark.parametrize("kind", ["spline", "corners"])
@pytest.mark.parametrize("after_s", [0.1, 0.6, 1.0, 1.7, 2.3, 3.1])
def test_a_stop_on_a_curve_ends_within_the_bound_that_the_monitor_looks_at(make_rig, kind, after_s):
    for seed in range(3):
        rig = make_rig()
        start(rig, kind, seed)
        rig.ticks(round(after_s / rig.period))
        planner = rig.group.planner
        assert not is_straight(planner.follower.trajectory)
        braking, looked_at = BrakingDistance(rig.limits, [np.arange(9)], REACTION_S), []
        s, sigma, rate = planner.setpoint, planner.follower.sigma, planner.follower.rate
        braking.displacement(s.v, s.a, {0: lambda seconds: looked_at.append(seconds) or s.v})  # noqa: B023
        seconds = halt(rig)
        assert planner.follower.sigma <= sigma + rate * looked_at[0]
        assert seconds < 1.5


@pytest.mark.parametrize("after_s", [0.2, 0.4, 0.6, 0.8, 0.95])
def test_a_stop_on_a_straight_leg_ends_on_it_though_a_joint_turns_at_its_end(make_rig, after_s):
    """Braking where the trajectory brakes for a point of its path ends at that point, not behind it."""
    rig = make_rig()
    start(rig, "straight", 0)
    rig.ticks(round(after_s / rig.period))
    assert rig.group.planner.ahead is None
    s = rig.group.planner.setpoint
    way = BrakingDistance(rig.limits, [np.arange(9)], REACTION_S).displacement(s.v, s.a)
    halt(rig)
    stopped = rig.group.planner.setpoint.q
    assert (np.abs(stopped - s.q) <= np.abs(way) + 1e-9).all()
    leg, direction = stopped - rig.home, s.v / np.linalg.norm(s.v)
    assert np.linalg.norm(leg - leg.dot(direction) * direction) < 1e-7
