"""A control law in a process of its own: the torques of one in the loop, and what happens when it is late or killed."""

import os
import re
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from im_cell.robot import load_cell
from im_core import clock
from im_core.errors import ConfigError
from im_core.processes.procfs import ProcessId
from im_mcs.control import ControlInput, ControllerSetup, LawSource, load_controller
from im_mcs.control.guard import ControlLawError
from im_mcs.limits.configuration import LawProcesses, load_config
from im_mcs.model import ControlledModel, Payload
from im_mcs.planning import Setpoint

CELL, CONFIG = load_cell(), load_config()
COMPUTED_TORQUE = "im_mcs.control.computed_torque:ComputedTorque"
MOODY = f"{Path(__file__).stem}:Moody"
TORQUE_LIMIT = CELL.per_joint("limits.torque")
LEFT = np.arange(3, 9)
PACED_S = 1.0  # so long that a computer at work elsewhere does not make the law late


class Moody:
    """Gravity and 1 Nm; slow where the setpoint is at 1, failing at 2, naming the process at 3."""

    def __init__(self, setup):
        if setup.parameters.get("broken"):
            raise RuntimeError("no hands")

    def reset(self): ...

    def hold_integral(self, hold): ...

    def torque(self, given):
        mood = given.setpoint.q[0]
        if mood == 1.0:
            clock.sleep(PACED_S)
        if mood == 2.0:
            raise KeyError("grip")
        return np.full(len(given.q), float(os.getpid())) if mood == 3.0 else given.gravity + 1.0


@pytest.fixture
def start(monkeypatch):
    """Starts the processes of laws, with the same laws in this process beside them."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *sys.path]))
    sources = []

    def start(law, wall_period_s=0.0, max_late=3, **parameters):
        laws = {law: parameters or CONFIG.switching.laws.get(law, {})}
        switching = CONFIG.switching.model_copy(update={"laws": laws, "handover_s": 0.05})
        processes = LawProcesses(laws=(law,), patience=0.4, max_late=max_late)
        config = CONFIG.model_copy(update={"switching": switching, "law_processes": processes})
        sources.append(LawSource(config, ControlledModel(CELL), TORQUE_LIMIT, wall_period_s))
        return sources[-1], sources[-1].laws_for("3x6", "left")

    yield start
    for source in sources:
        source.close()


def given(q_all, wanted, gravity):
    setpoint = Setpoint(wanted.q[LEFT], wanted.v[LEFT], wanted.a[LEFT])
    return ControlInput(q_all[LEFT], np.zeros(6), setpoint, gravity[LEFT], q_all, wanted)


def in_the_mood(value):
    wanted = Setpoint.at_rest(CELL.home)
    wanted.q[3] = value
    return given(CELL.home, wanted, np.linspace(0.0, 5.0, 18))


def process_of(laws):
    """Process id of the law, which tells it as a torque."""
    pid = int(laws.command(in_the_mood(3.0))[0])
    assert laws.late == 0
    assert pid not in (0, os.getpid())
    return pid


def test_torques_are_bit_for_bit_those_of_the_law_in_the_loop(start):
    """Random motions, with an integral that is frozen and freed, a reset, and a payload that comes and goes."""
    source, laws = start(COMPUTED_TORQUE, wall_period_s=60.0)  # no law is late on a busy computer
    laws.switch(COMPUTED_TORQUE)
    laws.reset()
    model, random = source._model, np.random.default_rng(1)
    parameters = CONFIG.switching.laws[COMPUTED_TORQUE]
    setup = ControllerSetup(LEFT, CONFIG.servo.period_s, model, TORQUE_LIMIT[LEFT], CELL.home, parameters)
    here = load_controller(COMPUTED_TORQUE, setup)
    for tick in range(120):
        if tick == 30:
            model.set_payload("left_wrist", Payload(2.0, (0.0, 0.0, 0.1)), 40)
        if tick == 100:
            laws.reset()
            here.reset()
        model.advance()
        q = CELL.home + random.normal(0, 1e-3, 18)
        question = given(q, Setpoint(CELL.home, *random.normal(0, 1, (2, 18))), model.gravity(q))
        hold = 80 <= tick < 90
        if not model.changing:
            laws.hold_integral(hold)
        here.hold_integral(hold)
        np.testing.assert_array_equal(laws.command(question), here.command(question))
    assert source.late == {COMPUTED_TORQUE: laws.late}
    assert laws.late == 0


def test_it_is_another_process_which_ends_with_its_source(start):
    source, laws = start(MOODY)
    laws.switch(MOODY)
    laws.reset()
    process = ProcessId.of(process_of(laws))
    assert process.alive()
    source.close()
    assert not process.alive()
    assert not [path for path in Path("/dev/shm").iterdir() if f"_law_{os.getpid()}_" in path.name]


def test_a_late_law_is_replaced_by_its_last_torques_with_the_gravity_of_now_and_counted(start):
    _, laws = start(MOODY, PACED_S)
    laws.switch(MOODY)
    laws.reset()
    question = in_the_mood(0.0)
    np.testing.assert_array_equal(laws.command(question), question.gravity + 1.0)
    slow = in_the_mood(1.0)
    heavier = slow._replace(gravity=slow.gravity + 0.5)
    np.testing.assert_allclose(laws.command(heavier), heavier.gravity + 1.0, rtol=1e-12)
    assert laws.late == 1
    clock.sleep(1.5 * PACED_S)  # in the meantime it has answered, and is asked anew
    np.testing.assert_array_equal(laws.command(question), question.gravity + 1.0)
    assert laws.late == 1


def test_late_too_often_is_an_error_that_says_so(start):
    source, laws = start(MOODY, 0.02)
    laws.switch(MOODY)
    laws.reset()
    for _ in range(2):
        laws.command(in_the_mood(1.0))
    with pytest.raises(ControlLawError, match=rf"'{MOODY}', in process \d+, .* within 2.667 ms in 3 ticks in a row"):
        laws.command(in_the_mood(1.0))
    assert source.late == {MOODY: 3}


def test_a_failing_law_is_named_as_in_the_loop(start):
    _, laws = start(MOODY)
    laws.switch(MOODY)
    laws.reset()
    with pytest.raises(ControlLawError, match=f"control law '{MOODY}': torque raised KeyError: 'grip'"):
        laws.command(in_the_mood(2.0))
    laws.command(in_the_mood(0.0))


def test_a_killed_law_is_an_error_that_names_it(start):
    _, laws = start(MOODY, max_late=1000)
    laws.switch(MOODY)
    laws.reset()
    pid = process_of(laws)
    os.kill(pid, signal.SIGKILL)

    def work():
        for _ in range(900):
            laws.command(in_the_mood(0.0))

    sentence = rf"the process of control law '{re.escape(MOODY)}' \(pid {pid}\) was ended by SIGKILL"
    with pytest.raises(ControlLawError, match=sentence):
        work()


def test_a_switch_to_it_and_back_has_no_bump(start):
    _, laws = start(MOODY)
    question = in_the_mood(0.0)
    torques = [laws.command(question)]
    for law in (MOODY, CONFIG.control.controller):
        laws.switch(law)
        torques += [laws.command(question) for _ in range(40)]
        assert not laws.switching
    steps = np.abs(np.diff(torques, axis=0))
    span = np.ptp(torques, axis=0)
    assert span.max() > 0.5
    assert (steps <= np.pi / 2 * span * CONFIG.servo.period_s / 0.05 * 1.1 + 1e-9).all()


def test_a_law_that_cannot_be_made_is_named_before_the_loop_begins(start):
    with pytest.raises(ConfigError, match=f"controller '{MOODY}' cannot be loaded: RuntimeError: no hands"):
        start(MOODY, broken=True)
