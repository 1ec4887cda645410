import numpy as np
import pytest

from im_core.errors import ConfigError
from im_mcs.control import ControlInput, ControllerSetup, load_controller
from im_mcs.planning import Setpoint


def test_tracks_and_rests_with_friction_and_encoder_noise(arm_bench, cell):
    """A move of all joints: under 2 mrad on the way, under 0.1 mrad at rest, then not a hair's breadth."""
    bench = arm_bench
    bench.to_motion("left")
    worst = np.zeros(9)

    def watch():
        error = np.abs(bench.mcs.setpoint[0] - bench.mcs.measured.q)[:9]
        np.maximum(worst, error, out=worst)

    target = cell.home[:9] + np.array([0.3, 0.5, 0.2, 0.6, -0.5, 0.6, 0.7, 0.7, 0.7])
    reply = bench.move("left", target, on_tick=watch)
    assert reply["success"], reply
    assert worst.max() < 2e-3
    monitor = bench.mcs.groups["left"].monitor
    np.testing.assert_allclose(monitor.q, target, atol=1e-4)
    np.testing.assert_allclose(monitor.q, bench.driver.q[:9], atol=2e-5)
    before = bench.driver.q.copy()
    for _ in range(60):
        bench.mcs.tick([])
    np.testing.assert_allclose(bench.driver.q, before, atol=1e-9)


def seen(q_all, target, gravity):
    """What the left group's law sees of an arm that stands still."""
    setpoint = Setpoint.at_rest(target)
    return ControlInput(q_all[:9], np.zeros(9), setpoint, gravity, q_all, Setpoint.at_rest(q_all))


def test_gravity_is_what_pid_gravity_adds(model, cell, config):
    index = np.arange(9)
    setup = ControllerSetup(index, 0.0045, model, np.full(9, 1e3), cell.home, dict(config.control.parameters))
    controller = load_controller("im_mcs.control.pid_gravity:PidGravity", setup)
    gravity = model.gravity(cell.home)[:9]
    given = seen(cell.home, cell.home[:9], gravity)
    np.testing.assert_allclose(controller.command(given), gravity)


def test_pid_pushes_towards_the_setpoint_and_integrates(model, cell, config):
    parameters = {k: v for k, v in config.control.parameters.items() if k != "feedforward"}
    setup = ControllerSetup(np.arange(9), 0.0045, model, np.full(9, 1e3), cell.home, parameters)
    controller = load_controller("im_mcs.control.pid:Pid", setup)
    given = seen(cell.home - 1e-3, cell.home[:9], np.zeros(9))
    torques = [controller.command(given) for _ in range(5)]
    assert (torques[0] > 0).all()
    assert (torques[-1] > torques[1]).all()
    controller.hold_integral(True)
    held = [controller.command(given) for _ in range(50)]
    np.testing.assert_allclose(held[-1], held[-2], rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("im_mcs.control.pid:Nothing", {}, "im_mcs.control.pid:Nothing.*module:Class"),
        ("nowhere:Pid", {}, "nowhere:Pid"),
        ("im_mcs.control.pid:Pid", {"bandwidth_rad_s": -1}, "bandwidth_rad_s"),
    ],
)
def test_what_cannot_be_loaded_is_named(model, cell, name, parameters, message):
    setup = ControllerSetup(np.arange(9), 0.0045, model, np.ones(9), cell.home, parameters)
    with pytest.raises(ConfigError, match=message):
        load_controller(name, setup)
