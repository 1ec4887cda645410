import threading

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import DataError, ImError
from im_mcs.client.kinematics import Kinematics
from im_mcs.collision import Bodies, CollisionChecker
from im_mcs.collision.braking_distance import BrakingDistance
from im_mcs.limits.limits import JointLimits
from im_mcs.limits.motion_limits import Synchrony
from im_mcs.planning import MotionLimits
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.motions.joint import JointPreparation
from im_mcs.planning.trajectories.trajectory import Setpoint
from im_mcs.protocol.requests import JointMove


@pytest.fixture(scope="module")
def kinematics(config, model):
    return Kinematics(config, model)


def test_a_long_path_check_does_not_keep_other_questions_waiting(kinematics, cell, monkeypatch):
    began, go, found = threading.Event(), threading.Event(), []
    look = CollisionChecker.require_free

    def slow(checker, *given):
        began.set()
        assert go.wait(60.0)
        return look(checker, *given)

    start = cell.home[:9].tolist()
    monkeypatch.setattr(CollisionChecker, "require_free", slow)
    checking = threading.Thread(target=lambda: found.append(kinematics.check_path("left", [start, start], cell.home)))
    checking.start()
    assert began.wait(60.0)
    try:
        assert kinematics.forward("left", [], cell.home).pose.translation[2] > 0.0
        pose = kinematics.forward("left", [], cell.home).pose
        turn = pin.Quaternion(pose.rotation).coeffs()
        kinematics.inverse("left", pose.translation, turn, [], cell.home, avoid_collisions=False)
    finally:
        go.set()
        checking.join()
    assert found[0] > 0.02


def test_paths_are_checked_on_the_way(kinematics, cell):
    """Both ends free, the carts meet in between."""
    start, through = cell.home[:9].tolist(), cell.home[:9].copy()
    through[0] = 0.8
    q = cell.home.copy()
    q[9] = 0.3
    assert kinematics.check_path("left", [start, start], cell.home) > 0.02
    with pytest.raises(ImError, match=r"on the way to point 1 .*left_.* right_") as caught:
        kinematics.check_path("left", [start, through.tolist()], q)
    assert {"first", "second", "distance_m", "clearance_m"} <= caught.value.facts.keys()
    with pytest.raises(DataError, match="a path of 0 points"):
        kinematics.check_path("left", [], q)
    with pytest.raises(DataError, match="blend -1 is not >= 0"):
        kinematics.check_path("left", [start, start], q, -1.0)


def test_what_is_close_to_an_arm_at_rest_keeps_no_other_arm_from_moving(kinematics, config, model, cell):
    """A line may lead nearer than a path: the collision watch alone says how near."""
    checker, q = CollisionChecker(model, config.collision.clearance_m), cell.home.copy()
    shoulder = model.index("right_j2")
    while (closest := checker.closest(q)).distance > 0.018:
        q[shoulder] -= 0.001
    assert closest.first.startswith("right_")
    assert closest.second.startswith("right_")
    with pytest.raises(ImError, match="at the end: right_"):
        kinematics.check_path("right", [q[9:].tolist()] * 2, q)
    pose = kinematics.forward("left", [], q).pose
    turn = pin.Quaternion(pose.rotation).coeffs()
    found = kinematics.inverse("left", pose.translation, turn, [], q, avoid_collisions=True)
    assert kinematics.check_path("left", [q[:9].tolist(), found.tolist()], q) > 0.02


class Detour:
    """A motion that ends where it begins, and on its way goes through another position."""

    duration = 2.0

    def __init__(self, start, through):
        self._start, self._through = start, through

    def span(self, t):
        share = np.sin(np.pi * t / self.duration)[:, None]
        return Setpoint.at_rest(self._start + share * (self._through - self._start))

    def point(self, t):
        return 0


def test_a_motion_is_checked_along_its_own_way(model, config, cell):
    """Straight from end to end nothing is in the way."""
    checker, index, velocity = CollisionChecker(model, config.collision.clearance_m), np.arange(9), np.ones(9)
    q = cell.home.copy()
    q[9] = 0.3
    through = cell.home[:9].copy()
    through[0] = 0.0
    free = checker.check_motion(q, index, Detour(cell.home[:9], cell.home[:9]), velocity)
    assert free == pytest.approx(checker.check_path(q, index, np.array([cell.home[:9], cell.home[:9]])))
    with pytest.raises(ImError, match=r"on the way to point 1 \(\d+ % of the time\): left_.* right_"):
        checker.check_motion(q, index, Detour(cell.home[:9], through), velocity)


@pytest.mark.parametrize("blend", [0.0, 0.05])
@pytest.mark.parametrize("synchrony", list(Synchrony))
def test_a_path_is_checked_as_a_move_is_planned(config, model, cell, monkeypatch, synchrony, blend):
    """The same planner, the same limits, from rest where the path begins."""
    planning = config.planning.model_copy(update={"synchrony": synchrony})
    kinematics = Kinematics(config.model_copy(update={"planning": planning}), model)
    start = cell.home[:9]
    points = [start + 0.1, start + np.linspace(0.0, 0.2, 9)]
    checked = []
    monkeypatch.setattr(CollisionChecker, "check_motion", lambda *arguments: checked.append(arguments) or 1.0)
    assert kinematics.check_path("left", [start.tolist(), *(p.tolist() for p in points)], cell.home, blend) == 1.0
    ((_, _, index, motion, velocity),) = checked
    limits = JointLimits(cell, config.limits, config.slots).motion.of(index)
    context = PlanContext(
        model, JointLimits(cell, config.limits, config.slots), index, (), lambda: cell.home, 0.0045,
        config.model_copy(update={"planning": planning}),
    )  # fmt: skip
    move = JointMove(points=[point.tolist() for point in points], blend=blend)
    preparation = JointPreparation(context, move, lambda: Setpoint.at_rest(start))
    while (planned := preparation.step()) is None:
        pass
    times = np.linspace(0.0, planned.duration, 50)
    assert motion.duration == planned.duration
    np.testing.assert_array_equal(motion.span(times).q, planned.span(times).q)
    np.testing.assert_array_equal(velocity, limits.velocity)


def test_distances_agree_with_sampled_capsules(model, cell):
    """Independent reference: capsules as dense rows of balls, boxes as points that are clamped to them."""
    checker = CollisionChecker(model, 0.02)
    bodies = Bodies(model)
    random = np.random.default_rng(2)
    lower, upper = cell.per_joint("limits.lower"), cell.per_joint("limits.upper")
    for _ in range(3):
        q = lower + random.uniform(size=18) * (upper - lower)
        poses = model.poses(q)
        rows, radii = [], [c.radius for c in cell.capsules]
        for c in cell.capsules:
            s = np.linspace(0.0, 1.0, 60)[:, None]
            line = np.array(c.p0) + s * (np.array(c.p1) - np.array(c.p0))
            rows.append(line @ poses[c.link].rotation.T + poses[c.link].translation)
        found = []
        for i, j in bodies.pairs:
            if j < len(rows):
                gap = np.linalg.norm(rows[i][:, None] - rows[j][None, :], axis=2).min() - radii[i] - radii[j]
            else:
                box = cell.obstacles[j - len(rows)]
                centre, half = np.array(box.center), np.array(box.size) / 2.0
                inside = np.clip(rows[i], centre - half, centre + half)
                gap = np.linalg.norm(rows[i] - inside, axis=1).min() - radii[i]
            found.append(gap)
        bodies.place(q)
        for pair, gap in enumerate(found):
            if gap > 0.0:
                assert bodies.distance(pair) == pytest.approx(gap, abs=6e-3)
                assert bodies.distance(pair) <= gap + 1e-6  # balls are part of the capsule
        assert checker.closest(q).distance <= min(found) + 1e-6


states = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))


@settings(max_examples=30, deadline=None)
@given(st.lists(states, min_size=2, max_size=2))
def test_braking_distance_is_that_of_a_simulated_brake(state):
    """Independent reference: jerk and acceleration limits, integrated in small steps."""
    limits = MotionLimits(np.array([1.0, 2.0]), np.array([2.0, 5.0]), np.array([20.0, 30.0]))
    v = np.array([s[0] for s in state]) * limits.velocity
    a = np.array([s[1] for s in state]) * limits.acceleration
    alone = BrakingDistance(limits, [], 0.0).displacement(v, a)
    for i in range(2):
        reference = _brake(float(v[i]), float(a[i]), float(limits.acceleration[i]), float(limits.jerk[i]))
        tolerance = 2e-3 + 0.01 * abs(reference)
        assert abs(alone[i]) >= abs(reference) - tolerance
        if v[i] * a[i] >= 0.0 or a[i] ** 2 <= 2.0 * limits.jerk[i] * abs(v[i]):  # else it swings back a little
            assert alone[i] == pytest.approx(reference, abs=tolerance)
    together = BrakingDistance(limits, [np.array([0, 1])], 0.0).displacement(v, a)
    assert (np.abs(together) >= np.abs(alone) - 1e-6).all()


def _brake(v: float, a: float, acceleration: float, jerk: float) -> float:
    """Farthest place in the direction of ``v`` when it is brought to rest as fast as limits allow."""
    sign, dt, x, farthest = (1.0 if v > 0.0 else -1.0), 2e-4, 0.0, 0.0
    v, a = abs(v), a * sign
    while v > 0.0:
        # decelerate as long as the velocity lost on the way back to zero acceleration leaves some
        after = v - a * a / (2.0 * jerk) if a < 0.0 else v
        a = max(a - jerk * dt, -acceleration) if after > 0.0 else min(a + jerk * dt, -1e-6)
        v += a * dt
        x += v * dt
        farthest = max(farthest, x)
    return sign * farthest


def test_a_thick_line_meets_what_is_in_its_way(model, cell):
    checker = CollisionChecker(model, 0.02)
    above, below = np.array([0.0, 1.15, 1.5]), np.array([0.0, 1.15, 0.2])
    assert checker.blocking(cell.home, above, below, 0.01) == "table"
    assert checker.blocking(cell.home, above, np.array([0.0, 1.15, 0.8]), 0.01) is None


def test_frames_are_found_with_their_jacobian(kinematics, model, cell):
    random = np.random.default_rng(3)
    q = cell.home[:9] + random.normal(size=9) * 0.2
    here = kinematics.forward("left", q.tolist(), cell.home)
    for i in range(9):
        step = q.copy()
        step[i] += 1e-6
        there = kinematics.forward("left", step.tolist(), cell.home)
        turn = pin.log3(there.pose.rotation @ here.pose.rotation.T)
        change = np.concatenate([there.pose.translation - here.pose.translation, turn]) / 1e-6
        np.testing.assert_allclose(here.jacobian[:, i], change, atol=1e-5)
    measured = kinematics.forward("left", [], cell.home, "left_link3")
    np.testing.assert_allclose(measured.pose.homogeneous, model.pose(cell.home, "left_link3").homogeneous)
    assert not kinematics.forward("left", [], cell.home, "right_wrist").jacobian.any()
    with pytest.raises(DataError, match="8 positions for 9 joints"):
        kinematics.forward("left", [0.0] * 8, cell.home)
