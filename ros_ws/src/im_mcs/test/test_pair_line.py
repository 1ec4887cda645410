"""Straight lines of two wrists that keep their relative pose, as if both held one part."""

import numpy as np
import pinocchio as pin
import pytest

from im_core.errors import ConfigError, ImError
from im_mcs.client.kinematics import Kinematics
from im_mcs.limits.configuration import Group, McsConfig
from im_mcs.limits.limits import JointLimits
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.line.geometry import CarriedPath
from im_mcs.planning.line.line import LinePreparation
from im_mcs.planning.trajectories.trajectory import Setpoint
from im_mcs.protocol.requests import LineMove

PERIOD = 0.0045
ALL = np.arange(18)
WRISTS = ("left_wrist", "right_wrist")


@pytest.fixture(scope="module")
def bent(cell):
    """Both arms well bent, and the carts so near that both could hold one plate."""
    q = cell.home.copy()
    q[0], q[9] = 0.2, 1.3
    q[7] = q[16] = 0.8
    return q


def both(model, q):
    return tuple(model.pose(q, wrist) for wrist in WRISTS)


def apart(model, q, start):
    """How far the pose of the second wrist in the first is from that at the start: [m], [rad]."""
    first, second = both(model, start)
    now_first, now_second = both(model, q)
    error = pin.log6((first.actInv(second)).actInv(now_first.actInv(now_second)))
    return float(np.linalg.norm(error.linear)), float(np.linalg.norm(error.angular))


def pose(of, step, turn=(0.0, 0.0, 0.0)):
    rotation = pin.exp3(np.array(turn)) @ of.rotation
    return [*(of.translation + step).tolist(), *pin.Quaternion(rotation).coeffs().tolist()]


def prepared(config, model, q, index, move):
    limits = JointLimits(model.cell, config.limits)
    context = PlanContext(model, limits, index, WRISTS, lambda: q, 2 * PERIOD, config)
    preparation = LinePreparation(context, move, lambda: Setpoint.at_rest(q[index]))
    for _ in range(5000):
        if (trajectory := preparation.step()) is not None:
            return trajectory
    raise AssertionError("the preparation does not end")


@pytest.mark.parametrize("index", [ALL, np.r_[9:18, 0:9]], ids=["left first", "right first"])
def test_both_wrists_keep_their_relative_pose(config, model, bent, index):
    first, _ = both(model, bent)
    poses = [
        pose(first, [0.05, 0.1, 0.0]),
        pose(first, [0.0, 0.1, -0.1], [0.0, 0.0, 0.1]),
        pose(first, [0.0, 0.0, 0.0]),
    ]
    trajectory = prepared(config, model, bent, index, LineMove(poses=poses, speed=0.25, blend=0.03))
    worst = np.zeros(2)
    for row in trajectory.span(np.arange(0.0, trajectory.duration, PERIOD)).q:
        q = bent.copy()
        q[index] = row
        worst = np.maximum(worst, apart(model, q, bent))
    assert worst[0] < 5e-5
    assert worst[1] < 1e-4
    end = trajectory.at(trajectory.duration).q
    whole = bent.copy()
    whole[index] = end
    for now, then in zip(both(model, whole), both(model, bent), strict=True):
        np.testing.assert_allclose(now.homogeneous, then.homogeneous, atol=1e-5)


def test_derivatives_of_a_carried_path():
    rng = np.random.default_rng(5)
    poses = [pin.SE3.Random() for _ in range(4)]
    path = CarriedPath(poses, rng.normal(size=(4, 3)), 0.1, 0.25, pin.SE3.Random())
    h = 1e-5
    for s in (*rng.uniform(h, path.size - h, 20), path.corners[1] + 0.03, path.corners[2] - 0.05):
        before, place, after = (path.at(s + step) for step in (-h, 0.0, h))
        linear = (after.pose.translation - before.pose.translation) / (2.0 * h)
        angular = pin.log3(after.pose.rotation @ before.pose.rotation.T) / (2.0 * h)
        np.testing.assert_allclose(place.twist, np.concatenate([linear, angular]), atol=1e-6)
        np.testing.assert_allclose(place.twist_rate, (after.twist - before.twist) / (2.0 * h), atol=1e-4)


def test_what_the_second_arm_cannot_do_is_refused_with_its_name(config, model, bent):
    first, _ = both(model, bent)
    with pytest.raises(ImError, match="right_") as refused:
        prepared(config, model, bent, ALL, LineMove(poses=[pose(first, [0.0, 0.0, 0.0], [0.0, 0.0, 2.5])], speed=0.25))
    assert refused.value.code in ("unreachable", "singular", "limit")


@pytest.mark.parametrize("seed", [3])
def test_measured_at_a_quarter_of_a_metre_a_second(config, plant_bench, model, bent, seed):
    """The issue's bar: 0.3 mm and 0.3 mrad between the true places of both wrists, while both move."""
    bench = plant_bench(config.with_preset("1x18"), seed)
    bench.to_motion("testbed")
    assert bench.move("testbed", bent)["success"]
    worst = np.zeros(2)
    start = bench.mcs.groups["testbed"].planner.setpoint.q.copy()
    first, _ = both(model, start)

    def look():
        nonlocal worst
        worst = np.maximum(worst, apart(model, bench.driver.plant.q, start))

    poses = [
        pose(first, [0.1, 0.15, 0.0]),
        pose(first, [0.1, 0.15, -0.1], [0.0, 0.0, 0.1]),
        pose(first, [0.0, 0.0, 0.0]),
    ]
    path = {"kind": "line", "poses": poses, "speed": 0.25, "blend": 0.02}
    reply = bench.ask("move", on_tick=look, group="testbed", path=path, policy="refuse", speed_scale=0.0)
    assert reply["success"], reply["error"]
    assert worst[0] < 3e-4
    assert worst[1] < 3e-4


def test_a_group_has_a_wrist_or_a_pair(config, model):
    with pytest.raises(ValueError, match="not both"):
        Group(joints=("left_j1",), wrist="left_wrist", pair=WRISTS)
    data = config.model_dump()
    data["presets"]["1x18"]["testbed"]["pair"] = ["left_wrist", "right_paw"]
    with pytest.raises(ConfigError, match=r"1x18.testbed.pair: there is no frame 'right_paw'"):
        Kinematics(McsConfig.model_validate(data), model)
