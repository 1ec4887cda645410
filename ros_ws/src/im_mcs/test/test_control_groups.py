"""Control laws in groups of any partition: an arm without its cart, two groups with two laws, what an arm carries."""

import numpy as np
import pytest

from im_mcs.model import ControlledModel, Payload

PID = "im_mcs.control.pid:Pid"
PID_GRAVITY = "im_mcs.control.pid_gravity:PidGravity"
COMPUTED_TORQUE = "im_mcs.control.computed_torque:ComputedTorque"
IMPEDANCE = "im_mcs.control.impedance:JointImpedance"
ARM, TRANSPORTER = np.arange(3, 9), np.array([0, 1, 2, 9, 10, 11])
WAY = {"left": np.array([0.6, -0.5, 0.6, 0.7, 0.7, 0.7]), "transporter": np.array([-0.3, 0.5, 0.2, -0.1, -0.3, -0.2])}


def path(q, group):
    return {"kind": "joint", "points": [(q + WAY[group]).tolist()]}


def follow(bench, goals):
    """Largest true error of each group until all goals have ended well, and where the joints then are."""
    plant, numbers = bench.driver.plant, {}
    for group, joints in goals.items():
        numbers[group] = bench.send("move", group=group, path=path(plant.q[joints].round(3), group))
    worst, q = dict.fromkeys(goals, 0.0), plant.q
    for _ in range(4000):
        bench.mcs.tick([])
        error = np.abs(bench.mcs.setpoint[0] - q)
        worst = {group: max(worst[group], error[joints].max()) for group, joints in goals.items()}
        q = plant.q
        if all(bench.reply(number) for number in numbers.values()):
            break
    assert all(bench.reply(number)["success"] for number in numbers.values()), [
        bench.reply(number) for number in numbers.values()
    ]
    return worst


@pytest.mark.parametrize(
    ("law", "bar"), [(PID, 5e-3), (PID_GRAVITY, 1e-3), (COMPUTED_TORQUE, 2e-4), (IMPEDANCE, 1e-3)], ids=lambda x: str(x)
)
def test_an_arm_without_its_cart_follows_every_law_and_the_cart_stays_braked(plant_bench, config, law, bar):
    bench = plant_bench(config.with_preset("3x6"), 1)
    cart = bench.driver.plant.q[:3]
    bench.to_motion("left")
    assert bench.ask("set_controller", group="left", controller=law)["success"]
    assert follow(bench, {"left": ARM})["left"] < bar
    np.testing.assert_allclose(bench.driver.plant.q[:3], cart, atol=1e-9)
    assert not bench.mcs.tau[:3].any()


def test_two_groups_move_at_once_with_two_laws(plant_bench, config):
    """The arm rides on the cart: computed torque knows what is wanted of the transporter, which has another law."""
    bench = plant_bench(config.with_preset("3x6"), 2)
    bench.to_motion("left", "transporter")
    assert bench.ask("set_controller", group="left", controller=COMPUTED_TORQUE)["success"]
    assert bench.mcs.groups["transporter"].controller.name == PID_GRAVITY
    worst = follow(bench, {"left": ARM, "transporter": TRANSPORTER})
    assert worst["left"] < 5e-4
    assert worst["transporter"] < 1.5e-3


@pytest.fixture
def laden(make_bench, frictionless, cell):
    """An arm that carries 2 kg, in loopback; the controller does not know, and has settled all the same."""
    truth = ControlledModel(cell)
    truth.set_payload("left_wrist", Payload(2.0, (0.0, 0.05, 0.15)), 1)
    truth.advance()
    bench = make_bench(frictionless)
    bench.driver._bias = truth.gravity
    bench.to_motion("left")
    return bench, truth


def test_what_an_arm_carries_moves_from_the_integral_to_the_model_without_a_bump(laden, cell):
    bench, truth = laden
    mcs = bench.mcs
    before = mcs.control_model.gravity(cell.home)
    taus, errors = [mcs.tau.copy()], []

    def watch():
        taus.append(mcs.tau.copy())
        errors.append(np.abs(mcs.setpoint[0] - mcs.measured.q)[:9].max())

    given = {"group": "left", "mass": 2.0, "center": [0.0, 0.05, 0.15], "inertia": [0.0] * 6}
    assert bench.ask("set_payload", watch, **given)["success"]
    ticks = round(mcs.config.switching.handover_s / mcs.config.servo.period_s)
    assert len(errors) > ticks
    assert mcs.groups["left"].monitor.at_rest
    np.testing.assert_allclose(mcs.control_model.gravity(cell.home), truth.gravity(cell.home), atol=1e-9)
    change = np.abs(truth.gravity(cell.home) - before)[:9].max()
    assert change > 5.0
    assert np.abs(np.diff(taus, axis=0))[:, :9].max() < 0.02 * change
    assert max(errors) < 1.5e-3  # the integral gives back what the model takes on


def test_an_arm_under_an_impedance_is_at_rest_where_its_load_has_pushed_it(laden):
    """It yields by millimetres and milliradians to what no model knows; no bound of the setpoint fits that."""
    bench, _ = laden
    assert bench.ask("set_controller", group="left", controller=IMPEDANCE)["success"]
    q = bench.mcs.setpoint[0][:9]
    reply = bench.ask("move", group="left", path={"kind": "joint", "points": [(q + 0.05).tolist()]})
    assert reply["success"], reply
    off = np.abs(bench.mcs.setpoint[0] - bench.mcs.measured.q)[:9].max()
    assert off > 2.0 * bench.mcs.config.servo.settle.still_tolerance


def test_each_wrist_of_a_group_of_two_carries_its_own(make_bench, frictionless, cell):
    bench = make_bench(frictionless.with_preset("1x18"))
    bench.to_motion("testbed")
    model, truth = bench.mcs.control_model, ControlledModel(cell)
    given = {"group": "testbed", "center": [0.0, 0.05, 0.1], "inertia": [0.0] * 6}
    for wrist, mass in (("right_wrist", 1.5), ("left_wrist", 0.5)):
        assert bench.ask("set_payload", wrist=wrist, mass=mass, **given)["success"]
        truth.set_payload(wrist, Payload(mass, (0.0, 0.05, 0.1)), 1)
        truth.advance()
        np.testing.assert_allclose(model.gravity(cell.home), truth.gravity(cell.home), atol=1e-9)
    for wrist, sentence in (("", "left_wrist and right_wrist"), ("left_wrist_", "left_wrist, right_wrist")):
        reply = bench.ask("set_payload", wrist=wrist, mass=1.0, **given)
        assert sentence in reply["error"]["message"]
    np.testing.assert_allclose(model.gravity(cell.home), truth.gravity(cell.home), atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"mass": 3.0}, "mass 3 kg is beyond the limit 2.5 kg"),
        ({"group": "testbed"}, "no group 'testbed'"),
        ({"group": "right"}, "'right' is not reserved"),
        ({"wrist": "right_wrist"}, "right_wrist"),
        ({"inertia": [1e-3, 0.0, 0.0, 1e-3, 0.0, 1.0]}, "triangle inequality"),
    ],
)
def test_a_payload_that_cannot_be_is_refused_and_nothing_changes(bench, cell, changes, sentence):
    bench.to_motion("left")
    before = bench.mcs.control_model.gravity(cell.home)
    given = {"group": "left", "mass": 1.0, "center": [0.0] * 3, "inertia": [0.0] * 6} | changes
    reply = bench.ask("set_payload", **given)
    assert not reply["success"]
    assert sentence in reply["error"]["message"]
    np.testing.assert_array_equal(bench.mcs.control_model.gravity(cell.home), before)
    assert not bench.mcs.control_model.changing
