"""While the rate changes, jerk keeps its limit: on a grid finer than the servo's, whatever the motion."""

import numpy as np
import pinocchio as pin
import pytest

FINER = 8
"""Ticks between two knots; the servo has two in the same time."""
PLANNED, OF_THE_CELL = 1.001, 1.001 / 0.95


@pytest.fixture
def fine(make_rig, config):
    """A group whose knots are as far apart as the servo's, and its setpoints a quarter."""
    period = config.servo.period_s * config.servo.planning_divisor / FINER
    return make_rig(FINER, servo=config.servo.model_copy(update={"period_s": period}))


def begin(rig, kind, way, random):
    def point(share=1.0):
        return rig.home + random.uniform(-share, share, len(way)) * way

    match kind:
        case "joint":
            return rig.move(point())
        case "corners":
            return rig.move(point(), point(), blend=0.1)
        case "line":
            pose = rig.context.model.pose(rig.q_all, "left_wrist")
            way = random.uniform(-0.15, 0.15, 3)
            place = [*(pose.translation + way).tolist(), *pin.Quaternion(pose.rotation).coeffs().tolist()]
            return rig.request({"kind": "line", "poses": [place], "speed": float(random.uniform(0.2, 0.6))})
    points = [{"time": 0.6 * k, "positions": point(0.6).tolist()} for k in range(1, 4)]
    return rig.request({"kind": "trajectory", "points": points})


def change(rig, random):
    match random.integers(3):
        case 0:
            rig.group.pause()
        case 1:
            rig.group.set_speed(float(random.uniform(0.1, 1.0)))
        case _:
            rig.group.resume()


def used(rig):
    """Largest jerk, acceleration and velocity of the setpoints, as shares of the limits."""
    limits = rig.limits
    jerk = np.abs(np.diff(rig.a, axis=0)) / rig.period / limits.jerk
    return jerk.max(), (np.abs(rig.a) / limits.acceleration).max(), (np.abs(rig.v) / limits.velocity).max()


@pytest.mark.parametrize(
    ("kind", "most"), [("joint", PLANNED), ("corners", OF_THE_CELL), ("line", PLANNED), ("spline", OF_THE_CELL)]
)
@pytest.mark.parametrize("seed", [1, 2])
def test_jerk_keeps_its_limit_while_the_rate_changes(fine, way, kind, most, seed):
    """Where a motion uses the limit up all the time, a stop may take what the cell has beyond the planning's."""
    random = np.random.default_rng(seed)
    goal = begin(fine, kind, way, random)
    while goal not in fine.results:
        change(fine, random)
        fine.ticks(int(random.integers(20, 400)))
    assert fine.code(goal) is None
    assert max(used(fine)) <= most
