"""Payload: torques next to those of a model that was built with it, fading, and what no body can be."""

import itertools

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_cell.robot import load_cell, urdf
from im_core.errors import DataError, LimitError, NotFoundError
from im_mcs.model import ControlledModel, Payload

CELL = load_cell()
BARE = ControlledModel(CELL)
CARRIED = Payload(1.5, (0.03, -0.02, 0.12), (0.011, 0.001, -0.002, 0.009, 0.0005, 0.006))
RANDOM = np.random.default_rng(8)
MOTIONS = [
    (CELL.home + RANDOM.uniform(-0.5, 0.5, 18), RANDOM.normal(0, 1, 18), RANDOM.normal(0, 3, 18)) for _ in range(4)
]


def built_with(wrist, payload):
    """The arm's URDF with one more link, fixed to the wrist: pinocchio's own parser adds the body."""
    x, y, z = payload.center
    xx, xy, xz, yy, yz, zz = payload.inertia
    body = f"""<link name="load"><inertial><origin xyz="{x} {y} {z}"/><mass value="{payload.mass}"/>
      <inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/></inertial></link>
      <joint name="load_mount" type="fixed"><parent link="{wrist}"/><child link="load"/></joint></robot>"""
    model = pin.buildModelFromXML(urdf(CELL, shapes=False).replace("</robot>", body))
    model.gravity.linear = np.array([0.0, 0.0, -CELL.gravity])
    model.armature = CELL.per_joint("rotor_inertia")
    return model


def carrying(*orders):
    model = ControlledModel(CELL)
    for wrist, payload in orders:
        model.set_payload(wrist, payload, 1)
    model.advance()
    return model


@pytest.fixture
def model():
    return ControlledModel(CELL)


@pytest.mark.parametrize("wrist", BARE.wrists)
def test_torques_are_those_of_a_model_built_with_the_body(model, wrist):
    reference = built_with(wrist, CARRIED)
    data = reference.createData()
    model.set_payload(wrist, CARRIED, 1)
    model.advance()
    for q, v, a in MOTIONS:
        gravity = pin.computeGeneralizedGravity(reference, data, q)
        np.testing.assert_allclose(model.gravity(q), gravity, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(model.inverse_dynamics(q, v, a), pin.rnea(reference, data, q, v, a), atol=1e-9)
        assert np.abs(gravity - BARE.gravity(q)).max() > 0.5


def test_it_enters_along_half_a_cosine_and_leaves_no_trace(model):
    q, v, a = MOTIONS[0]
    ticks = 50
    seen = [model.inverse_dynamics(q, v, a)]
    for payload in (CARRIED, Payload(0.0)):
        model.set_payload("left_wrist", payload, ticks)
        for _ in range(ticks):
            assert model.changing
            model.advance()
            seen.append(model.inverse_dynamics(q, v, a))
        assert not model.changing
    seen = np.array(seen)
    steps = np.abs(np.diff(seen, axis=0))
    assert (steps <= np.pi / 2 * np.abs(seen[ticks] - seen[0]) / ticks + 1e-9).all()
    np.testing.assert_allclose(seen[-1], seen[0], atol=1e-9)
    np.testing.assert_allclose(seen[ticks // 2], (seen[0] + seen[ticks]) / 2, atol=1e-9)


def test_a_change_of_mind_and_the_other_arm_have_no_bump(model):
    q, v, a = MOTIONS[1]
    ticks, seen = 40, []
    orders = {3: ("left_wrist", CARRIED), 20: ("right_wrist", Payload(2.5)), 35: ("left_wrist", Payload(0.4))}
    for tick in range(100):
        if tick in orders:
            model.set_payload(*orders[tick], ticks)
        model.advance()
        seen.append(model.inverse_dynamics(q, v, a))
    largest = sum(np.abs(carrying(order).inverse_dynamics(q, v, a) - seen[0]) for order in orders.values())
    assert (np.abs(np.diff(seen, axis=0)) <= np.pi / 2 * largest / ticks + 1e-9).all()
    expected = carrying(orders[20], orders[35]).inverse_dynamics(q, v, a)
    np.testing.assert_allclose(seen[-1], expected, atol=1e-9)


def test_another_model_carries_the_same(model):
    model.set_payload("left_wrist", CARRIED, 3)
    model.advance()
    other = ControlledModel(CELL)
    other.carry(model.carried.copy())
    q, v, a = MOTIONS[2]
    np.testing.assert_array_equal(other.inverse_dynamics(q, v, a), model.inverse_dynamics(q, v, a))


def test_a_wrong_model_carries_what_it_was_told():
    q = MOTIONS[3][0]
    wrong = ControlledModel(CELL, 0.2)
    before = wrong.gravity(q)
    wrong.set_payload("left_wrist", CARRIED, 1)
    wrong.advance()
    right = carrying(("left_wrist", CARRIED))
    np.testing.assert_allclose(wrong.gravity(q) - before, right.gravity(q) - BARE.gravity(q), atol=1e-9)
    with pytest.raises(NotFoundError, match="did you mean 'left_wrist'"):
        wrong.set_payload("left_wirst", CARRIED, 1)


def test_a_payload_may_be_told_while_the_arm_moves(bench, cell):
    """It fades in; the motion goes on, and the arm follows it as closely as one may while the model is wrong."""
    bench.to_motion("left")
    target = cell.home[:9] + np.array([0.3, 0.5, 0.1, 0.4, -0.4, 0.4, 0.5, 0.5, 0.5])
    move = bench.send("move", group="left", path={"kind": "joint", "points": [target.tolist()]})
    for _ in range(150):
        bench.mcs.tick([])
    before, errors, steps = bench.mcs.tau.copy(), [], []
    told = bench.send("set_payload", group="left", mass=1.0, center=[0.0, 0.0, 0.05], inertia=[0.0] * 6)
    assert bench.reply(told)["success"]
    while bench.reply(move) is None:
        steps.append(np.abs(bench.mcs.tau - before)[:9])
        before = bench.mcs.tau.copy()
        bench.mcs.tick([])
        errors.append(np.abs(bench.mcs.setpoint[0] - bench.driver.q)[:9].max())
    assert bench.reply(move)["success"]
    assert max(errors) < 0.2 * bench.mcs.limits.following_error[:9].min()
    assert (np.max(steps, axis=0) < 0.05 * bench.mcs.limits.torque[:9]).all()
    assert not bench.mcs.control_model.changing
    for mass, words in ((9.0, "mass 9 kg is beyond the limit 2.5 kg"), (-1.0, "mass -1.0 is not a finite number >= 0")):
        reply = bench.ask("set_payload", group="left", mass=mass, center=[0.0] * 3, inertia=[0.0] * 6)
        assert words in reply["error"]["message"]


ZERO = [0.0] * 6
SPHERE = [0.01, 0.0, 0.0, 0.01, 0.0, 0.01]


@pytest.mark.parametrize(
    ("mass", "center", "inertia", "error", "sentence"),
    [
        (-0.1, [0, 0, 0], ZERO, LimitError, "payload: mass -0.1 kg is beyond the limit 0 kg"),
        (2.6, [0, 0, 0], ZERO, LimitError, "payload: mass 2.6 kg is beyond the limit 2.5 kg"),
        (float("nan"), [0, 0, 0], ZERO, DataError, "mass is .nan., not 1 finite number"),
        (1.0, [0, 0], ZERO, DataError, "center is .0, 0., not 3 finite numbers"),
        (1.0, [0, 0, -0.5], ZERO, LimitError, "center.z -0.5 m is beyond the limit -0.4 m"),
        (1.0, [0, 0, 0], SPHERE[:5], DataError, "inertia is .*, not 6 finite numbers"),
        (
            1.0,
            [0, 0, 0],
            [0.01, 0.02, 0, 0.01, 0, 0.01],
            DataError,
            "not positive definite: a principal moment",
        ),
        (1.0, [0, 0, 0], [0.01, 0, 0, 0.01, 0, 0.03], DataError, "triangle inequality.*sum up to less than 0.03"),
        (1.0, [0, 0, 0], [1.0, 0, 0, 1.0, 0, 1.0], LimitError, "principal moment 1 kg m2 is beyond the limit 0.32"),
        (0.0, [0, 0, 0], SPHERE, DataError, "without mass there is no inertia"),
    ],
)
def test_what_no_body_can_be_is_refused(mass, center, inertia, error, sentence):
    with pytest.raises(error, match=sentence):
        Payload.checked(mass, center, inertia, 2.5, 0.4)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)), min_size=4, max_size=8))
def test_whatever_some_points_of_mass_make_up_is_allowed(points):
    """A body made of points has an inertia that a body can have, unless they lie on a line."""
    where = np.array(points) - np.mean(points, axis=0)
    moments = sum(0.2 * (p @ p * np.eye(3) - np.outer(p, p)) for p in where)
    if np.linalg.eigvalsh(moments)[0] < 1e-9:
        return
    inertia = [float(moments[i, j]) for i, j in itertools.combinations_with_replacement(range(3), 2)]
    payload = Payload.checked(0.2 * len(where), [0.0, 0.0, 0.0], inertia, 2.5, 0.4)
    np.testing.assert_allclose(payload.moments, moments)
