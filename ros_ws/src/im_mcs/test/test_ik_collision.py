import numpy as np
import pinocchio as pin
import pytest

from im_core.errors import DataError, ImError, LimitError, NotFoundError, StateError
from im_mcs.client.kinematics import Kinematics
from im_mcs.collision import CollisionChecker
from im_mcs.limits import JointLimits


@pytest.fixture(scope="module")
def kinematics(config, model):
    return Kinematics(config, model)


def test_poses_of_random_positions_are_found_again(kinematics, config, model, cell):
    limits = JointLimits(model, config.limits)
    random = np.random.default_rng(11)
    for _ in range(12):
        q = cell.home.copy()
        q[:9] = limits.lower[:9] + random.uniform(size=9) * (limits.upper - limits.lower)[:9]
        pose = model.pose(q, "left_wrist")
        quaternion = pin.Quaternion(pose.rotation).coeffs()
        found = kinematics.inverse("left", pose.translation, quaternion, [], cell.home, False)
        again = cell.home.copy()
        again[:9] = found
        assert pin.log6(model.pose(again, "left_wrist").actInv(pose)).np == pytest.approx(0.0, abs=1e-6)
        assert (limits.lower[:9] <= found).all()
        assert (found <= limits.upper[:9]).all()


def test_the_cart_is_used_for_what_the_arm_cannot_reach(kinematics, cell):
    found = kinematics.inverse("left", [0.9, 0.0, 1.2], [0.0, 1.0, 0.0, 0.0], [], cell.home, True)
    assert found[0] > 0.0


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"position": [0.0, 0.0, 9.0]}, DataError, r"left_wrist at \(0.000, 0.000, 9.000\) m is out of reach.*mm"),
        ({"position": [float("nan"), 0.0, 1.0]}, DataError, "not a finite number"),
        ({"orientation": [0.0, 0.0, 0.0, 2.0]}, DataError, "not a unit quaternion"),
        ({"seed": [0.0] * 8}, DataError, "8 positions for 9 joints"),
        ({"seed": [9.0] + [0.0] * 8}, LimitError, "left_track.*9 m.*0.845 m"),
        ({"group": "middle"}, NotFoundError, "middle.*left, right"),
    ],
)
def test_wrong_requests_are_refused(kinematics, cell, change, error, message):
    request = {"group": "left", "position": [0.0, 0.0, 1.2], "orientation": [0.0, 0.0, 0.0, 1.0], "seed": []}
    with pytest.raises(error, match=message):
        kinematics.inverse(**{**request, **change}, q_all=cell.home, avoid_collisions=False)


def test_a_group_without_wrist_has_no_inverse(config, model, cell):
    with pytest.raises(StateError, match=r"transporter.*no wrist"):
        Kinematics(config.with_preset("3x6"), model).inverse(
            "transporter", [0, 0, 1], [0, 0, 0, 1], [], cell.home, False
        )


def test_a_pose_inside_the_table_is_in_collision(kinematics, cell):
    with pytest.raises(ImError, match=r"left_link.*(collide with|too close to) table") as caught:
        kinematics.inverse("left", [-0.3, 0.95, 0.55], [0.0, 1.0, 0.0, 0.0], [], cell.home, True)
    assert caught.value.code == "collision"


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


def test_distances_agree_with_sampled_capsules(model, cell):
    """Independent reference: capsules as dense rows of balls."""
    checker = CollisionChecker(model, 0.02)
    random = np.random.default_rng(2)
    lower, upper = cell.per_joint("limits.lower"), cell.per_joint("limits.upper")
    for _ in range(3):
        q = lower + random.uniform(size=18) * (upper - lower)
        poses = model.poses(q)
        rows = {}
        for k, c in enumerate(cell.capsules):
            s = np.linspace(0.0, 1.0, 60)[:, None]
            line = np.array(c.p0) + s * (np.array(c.p1) - np.array(c.p0))
            rows[k] = poses[c.link].act(pin.SE3.Identity()).rotation @ line.T + poses[c.link].translation[:, None]
        closest = checker.closest(q)
        between_arms = [
            np.linalg.norm(rows[i][:, :, None] - rows[j][:, None, :], axis=0).min() - a.radius - b.radius
            for i, a in enumerate(cell.capsules)
            for j, b in enumerate(cell.capsules)
            if a.link.startswith("left") and b.link.startswith("right")
        ]
        assert closest.distance <= min(between_arms) + 5e-3
