"""The laws that use the whole model: what they say, not how well the arm follows."""

import re
import sys

import numpy as np
import pydantic
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_cell.robot import load_cell
from im_core.errors import ConfigError
from im_mcs.control import ControlInput, ControllerSetup, load_controller
from im_mcs.limits.configuration import McsConfig, Switching, load_config
from im_mcs.model import CellModel
from im_mcs.planning import Setpoint
from im_mcs.state import State

CONFIG, CELL = load_config(), load_cell()
MODEL = CellModel(CELL)
LEFT = np.arange(9)
COMPUTED_TORQUE = "im_mcs.control.computed_torque:ComputedTorque"
IMPEDANCE = "im_mcs.control.impedance:JointImpedance"


def make(law, **changes):
    parameters = {**CONFIG.switching.laws[law], **changes}
    return load_controller(law, ControllerSetup(LEFT, 0.0045, MODEL, np.full(9, 1e4), CELL.home, parameters))


def seen(wanted, error):
    """What the left group sees whose joints are ``error`` behind."""
    q = wanted.q.copy()
    q[LEFT] -= error
    setpoint = Setpoint(wanted.q[LEFT], wanted.v[LEFT], wanted.a[LEFT])
    return ControlInput(q[LEFT], wanted.v[LEFT], setpoint, MODEL.gravity(q)[LEFT], q, wanted)


@st.composite
def motions(draw):
    random = np.random.default_rng(draw(st.integers(0, 10_000)))
    return Setpoint(CELL.home + random.uniform(-0.3, 0.3, 18), random.normal(0, 1, 18), random.normal(0, 3, 18))


@settings(max_examples=30, deadline=None)
@given(motions(), st.sampled_from([COMPUTED_TORQUE, IMPEDANCE]))
def test_without_an_error_the_torque_is_that_of_the_motion_and_its_friction(wanted, law):
    direction = np.sign(wanted.v)
    coulomb = np.where(direction > 0, MODEL.coulomb_positive, MODEL.coulomb_negative) * direction
    expected = MODEL.inverse_dynamics(wanted.q, wanted.v, wanted.a) + coulomb + MODEL.viscous_friction * wanted.v
    fast = np.abs(wanted.v[LEFT]) > 0.02
    torque = make(law).command(seen(wanted, 0.0))
    np.testing.assert_allclose(torque[fast], expected[LEFT][fast], rtol=1e-9, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(motions())
def test_computed_torque_turns_the_error_into_an_acceleration(wanted):
    """ABA, which the law does not use, tells the acceleration that its torques cause: ``a_d + w^2 e``."""
    import pinocchio as pin

    law = make(COMPUTED_TORQUE, feedforward={})
    error = np.linspace(-1e-3, 1e-3, 9)
    given_ = seen(wanted, error)
    tau = MODEL.inverse_dynamics(given_.q_all, wanted.v, wanted.a)
    tau[LEFT] = law.command(given_)
    a = pin.aba(MODEL.pin, MODEL.pin.createData(), given_.q_all, wanted.v, tau)
    w = CONFIG.switching.laws[COMPUTED_TORQUE]["bandwidth_rad_s"]
    np.testing.assert_allclose(a[LEFT], wanted.a[LEFT] + w**2 * error, atol=1e-6)


def test_an_impedance_yields_in_proportion_to_what_pushes_it():
    law, wanted = make(IMPEDANCE, feedforward={}), Setpoint.at_rest(CELL.home)
    at_rest = law.command(seen(wanted, 0.0))
    expected = CELL.per_joint("stiffness")[:9]
    for error in (1e-3, -2e-3):
        law.reset()
        displaced = seen(wanted, 0.0)
        displaced = displaced._replace(setpoint=Setpoint.at_rest(wanted.q[LEFT] + error))
        np.testing.assert_allclose(law.command(displaced) - at_rest, expected * error, rtol=1e-9)
        for _ in range(100):
            held = law.command(displaced)
        np.testing.assert_allclose(held - at_rest, expected * error, rtol=1e-9)  # nothing accumulates


def test_a_wrong_model_has_all_masses_and_inertias_wrong_and_nothing_else():
    random = np.random.default_rng(4)
    wrong = CellModel(CELL, -0.25)
    for _ in range(5):
        q, v, a = CELL.home + random.uniform(-0.5, 0.5, 18), random.normal(0, 1, 18), random.normal(0, 1, 18)
        np.testing.assert_allclose(wrong.inverse_dynamics(q, v, a), 0.75 * MODEL.inverse_dynamics(q, v, a), atol=1e-9)
        np.testing.assert_allclose(wrong.inertia(q), 0.75 * MODEL.inertia(q), atol=1e-12)
        np.testing.assert_array_equal(wrong.pose(q, "left_wrist"), MODEL.pose(q, "left_wrist"))


@pytest.mark.parametrize("error", [-1.0, 11.0, float("nan"), "large"])
def test_a_model_error_that_makes_no_sense_is_refused(error):
    with pytest.raises(pydantic.ValidationError, match="model_error"):
        McsConfig.model_validate({**CONFIG.model_dump(), "model_error": error})


@pytest.mark.parametrize(
    ("law", "changes", "message"),
    [
        (
            IMPEDANCE,
            {"stiffness": {"left_track": -1.0}},
            "'stiffness.left_track': -1.0: .*greater than 0",
        ),
        (IMPEDANCE, {"damping": 0.0}, "'damping'"),
        (COMPUTED_TORQUE, {"feedforward": {"friction": 2.0}}, "'feedforward.friction'"),
        (COMPUTED_TORQUE, {"bandwith": 2.0, "damping": -1.0}, "'damping': -1.0: .*; parameter 'bandwith': 2.0: .*mean"),
    ],
)
def test_wrong_parameters_are_named(law, changes, message):
    with pytest.raises(ConfigError, match=f"^controller '{law}': parameter .*{message}"):
        make(law, **changes)


class Faulty:
    """A law that fails in the way and at the call it is told."""

    def __init__(self, setup):
        self.fault, self.calls_left = setup.parameters["fault"], setup.parameters["after"]
        if self.fault == "construction":
            raise RuntimeError("no hands")

    def reset(self): ...

    def hold_integral(self, hold):
        if self.fault == "hold_integral" and self.calls_left < 0:
            raise KeyError("grip")

    def torque(self, given):
        self.calls_left -= 1
        if self.calls_left >= 0:
            return given.gravity
        return {
            "zero division": lambda: 1 / 0,
            "nan": lambda: np.where(np.arange(len(given.q)) == 3, np.nan, 0.0),
            "shape": lambda: np.zeros(3),
            "text": lambda: "strong",
            "exit": sys.exit,
        }.get(self.fault, lambda: given.gravity)()


FAULTY = f"{__name__}:Faulty"


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        ("zero division", "torque raised ZeroDivisionError"),
        ("nan", "returned nan as torque of joint 4 of 9"),
        ("shape", r"torque returned shape \(3,\), not \(9,\)"),
        ("text", "torque raised ValueError"),
        ("exit", "torque raised SystemExit"),
        ("hold_integral", "hold_integral raised KeyError"),
    ],
)
def test_a_law_that_fails_is_an_estop_in_the_same_tick(config, make_bench, fault, sentence):
    laws = {FAULTY: {"fault": fault, "after": 40}}
    bench = make_bench(config.model_copy(update={"switching": Switching(handover_s=0.1, laws=laws)}))
    bench.to_motion("left")
    assert bench.reply(bench.send("set_controller", group="left", controller=FAULTY))["success"]
    for _ in range(200):
        bench.mcs.tick([])
        if bench.mcs.manager.state is State.ESTOPPED:
            break
    assert bench.mcs.manager.state is State.ESTOPPED
    assert re.search(f"control law '{re.escape(FAULTY)}'.* {sentence}.*, at tick", bench.mcs.manager.cause)
    assert not bench.mcs.tau.any()
    assert not bench.driver.drive.power
    assert bench.driver.drive.brakes.all()


def test_a_law_that_cannot_be_made_is_named():
    setup = ControllerSetup(LEFT, 0.0045, MODEL, np.ones(9), CELL.home, {"fault": "construction", "after": 0})
    with pytest.raises(ConfigError, match="Faulty' cannot be loaded: RuntimeError: no hands"):
        load_controller(FAULTY, setup)
