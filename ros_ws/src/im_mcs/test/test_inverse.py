import numpy as np
import pinocchio as pin
import pytest

from im_core.errors import DataError, ImError, LimitError, NotFoundError, StateError
from im_mcs.client.kinematics import Kinematics
from im_mcs.inverse import Arm, ArmTracker, InverseKinematics
from im_mcs.inverse.redundancy import Redundancy
from im_mcs.limits.limits import JointLimits


@pytest.fixture(scope="module")
def kinematics(config, model):
    return Kinematics(config, model)


@pytest.fixture(scope="module")
def limits(config, model):
    return JointLimits(model.cell, config.limits)


def test_poses_of_random_positions_are_found_again(kinematics, limits, model, cell):
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
        (
            {"position": [9.0, 0.0, 1.2]},
            DataError,
            r"solution is at \([0-9., -]+\) m, .* deg off, with joints against their limits: left_track 0.845 m",
        ),
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


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_factors_make_up_the_determinant(model, cell, side):
    """The determinant from pinocchio is that of the three factors, at any position."""
    arm = Arm(model, f"{side}_wrist")
    random = np.random.default_rng(5)
    ratios = []
    for _ in range(20):
        q = cell.home.copy()
        q[arm.joints] = random.uniform(-2.5, 2.5, size=6)
        determinant = np.linalg.det(model.jacobian(q, f"{side}_wrist")[:, arm.joints])
        ratios.append(determinant / np.prod(arm.factors(q[arm.joints])))
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-9)
    gradient_at = random.uniform(-2.5, 2.5, size=6)
    lack = lambda q: -0.5 * sum(max(0.99 - abs(f), 0.0) ** 2 for f in arm.factors(q))  # noqa: E731
    numeric = [(lack(gradient_at + h) - lack(gradient_at - h)) / 2e-6 for h in 1e-6 * np.eye(6)]
    np.testing.assert_allclose(arm.away(gradient_at, 0.99), numeric, atol=1e-5)


def test_reach_ends_where_the_arm_is_stretched(model, cell):
    arm = Arm(model, "left_wrist")
    random = np.random.default_rng(6)
    for _ in range(20):
        q = cell.home.copy()
        q[:9] += random.uniform(-0.5, 0.5, size=9)
        wrist = model.pose(q, "left_wrist").translation
        assert arm.beyond_reach(q, wrist) == pytest.approx(0.0, abs=1e-9)
    shoulder = model.pose(cell.home, "left_link2").translation
    reached = [model.pose(_with(cell.home, 5, x), "left_wrist").translation for x in np.linspace(-3.9, 0.7, 999)]
    farthest = max(reached, key=lambda wrist: np.linalg.norm(wrist - shoulder))
    outwards = (farthest - shoulder) / np.linalg.norm(farthest - shoulder)
    assert arm.beyond_reach(cell.home, farthest + 1e-5 * outwards) > 0.0
    assert arm.beyond_reach(cell.home, farthest + 0.1 * outwards) == pytest.approx(0.1, abs=0.01)
    assert arm.beyond_reach(cell.home, shoulder) > 0.1


def _with(q, joint, value):
    q = q.copy()
    q[joint] = value
    return q


def test_spare_joints_keep_off_limits_and_singularities(limits, model, cell, monkeypatch):
    """Compared with the same search whose spare joints only seek their preferred position."""
    index, random = np.arange(9), np.random.default_rng(8)
    arm = Arm(model, "left_wrist")
    tracker = ArmTracker(model, arm, "left_wrist")
    targets = []
    while len(targets) < 12:
        q = cell.home.copy()
        q[:9] += random.uniform(-0.7, 0.7, size=9)
        if (q > limits.lower).all() and (q < limits.upper).all():
            targets.append(model.pose(q, "left_wrist"))

    def comfort():
        solver = InverseKinematics(model, limits, index, "left_wrist")
        found = [_put(cell.home, index, solver.solve(t, cell.home, cell.home[index])) for t in targets]
        margins = [np.minimum(q - limits.lower, limits.upper - q)[:9].min() for q in found]
        return np.mean(margins), np.mean([tracker.singular_value(q) for q in found]), found

    margin, singular_value, found = comfort()
    again = comfort()[2]
    np.testing.assert_array_equal(found, again)
    monkeypatch.setattr(Redundancy, "wish", lambda self, q: self._preferred - q)
    plain = comfort()
    assert margin > plain[0]
    assert singular_value > plain[1]


def _put(q_all, index, q):
    whole = q_all.copy()
    whole[index] = q
    return whole
