"""The collision monitor in the loop: from the tick's distances to the group's brakes, and back."""

import numpy as np
import pytest

from im_mcs.collision import CollisionChecker
from im_mcs.planning.trajectories.straight_stop import is_straight
from im_mcs.protocol.points import TimedPoints, pack_points


@pytest.fixture(scope="module")
def checker(config, model):
    return CollisionChecker(model, config.collision.clearance_m)


@pytest.fixture
def nearest(bench, checker):
    """Smallest distance of all ticks so far."""
    found = [np.inf]

    def look():
        if bench.mcs.measured.tick % 4 == 0:
            found[0] = min(found[0], checker.closest(bench.mcs.measured.q).distance)
        return found[0]

    return look


def test_carts_that_run_at_each_other_stop_before_they_touch(bench, cell, nearest):
    bench.to_motion("left", "right")
    left, right = cell.home[:9].copy(), cell.home[9:].copy()
    left[0], right[0] = 0.8, -0.8
    numbers = [
        bench.send(
            "move",
            group=group,
            path={"kind": "joint", "points": [point.tolist()], "blend": 0.0},
            policy="refuse",
            speed_scale=0.0,
        )
        for group, point in (("left", left), ("right", right))
    ]
    for _ in range(3000):
        bench.mcs.tick([])
        nearest()
        if all(bench.reply(number) for number in numbers):
            break
    for number in numbers:
        reply = bench.reply(number)
        assert not reply["success"]
        assert reply["error"]["code"] == "collision"
        assert "left_" in reply["error"]["message"]
        assert "right_" in reply["error"]["message"]
    assert nearest() > 0.0
    back = bench.move("left", cell.home[:9])
    assert back["success"], back
    assert nearest() > 0.0


@pytest.mark.parametrize("seed", range(2))
def test_curved_motions_towards_the_table_stop_before_they_touch_it(bench, config, cell, checker, nearest, seed):
    """Splines and rounded corners at speed: a stop takes longer there, and does not lead straight on."""
    random = np.random.default_rng(seed)
    home, down = cell.home[:9], np.array([0.0, 0.0, 0.0, 0.77, -0.93, 0.67, 0.0, 0.0, 0.0])
    aside = np.concatenate([np.zeros(3), random.uniform(-0.3, 0.3, 6)])
    points = [home + share * down + swing * aside for share, swing in ((0.7, 1.0), (1.4, -1.0), (2.1, 0.3), (2.3, 0.0))]
    bench.to_motion("left")
    if seed % 2 == 0:
        path = {"kind": "joint", "points": [point.tolist() for point in points], "blend": 0.2}
    else:
        timed = pack_points(TimedPoints(1.1 * np.arange(1.0, 5.0), np.array(points), None, None))
        tolerances = {"path_tolerance": [], "goal_tolerance": [], "goal_time_tolerance": 0.0}
        path = {"kind": "trajectory", "points": timed, **tolerances}
    number = bench.send("move", group="left", path=path, policy="refuse", speed_scale=0.0)
    group, crossed = bench.mcs.groups["left"], np.inf
    for _ in range(3000):
        bench.mcs.tick([])
        trajectory = getattr(group.planner.follower, "trajectory", None)
        if crossed == np.inf and trajectory is not None:
            assert not is_straight(trajectory)
            q = cell.home.copy()
            for t in np.linspace(0.0, trajectory.duration, 60):
                q[:9] = trajectory.at(float(t)).q
                crossed = min(crossed, checker.closest(q).distance)
        nearest()
        if bench.reply(number):
            break
    assert crossed < 0.0  # the motion as a whole would have gone through the table
    reply = bench.reply(number)
    assert reply["error"]["code"] == "collision", reply
    assert nearest() >= config.collision.stop_m
