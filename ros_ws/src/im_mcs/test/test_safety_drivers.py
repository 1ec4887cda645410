"""Drivers that fail, power and brakes that do not obey, torques that a client drives itself."""

import math

import numpy as np
import pytest

from im_core.errors import LinkError
from im_mcs.state import State

LEFT = slice(0, 9)
WAYS = {
    State.COLD: [],
    State.RESERVED: ["reserve"],
    State.ACTIVE: ["reserve", "power_on"],
    State.MOTION: ["reserve", "power_on", "enable_motion"],
    State.ESTOPPED: ["reserve", "estop"],
}


def bring_to(bench, state):
    given = {"reserve": {"group": "left"}, "estop": {"reason": "test"}}
    for request in WAYS[state]:
        assert bench.ask(request, **given.get(request, {}))["success"]


def raising(error):
    def call(*_):
        raise error

    return call


@pytest.mark.parametrize("state", WAYS)
@pytest.mark.parametrize("method", ["read", "write"])
@pytest.mark.parametrize("error", [LinkError("the cable is cut"), RuntimeError("a bug"), OSError("no device")])
def test_a_driver_that_raises_is_a_link_error_and_an_estop_where_power_may_be(bench, state, method, error):
    bring_to(bench, state)
    setattr(bench.driver, method, raising(error))
    with pytest.raises(LinkError, match=str(error)) as caught:
        bench.mcs.tick([])
    bench.mcs.lose_testbed(caught.value)
    expected = State.COLD if state is State.COLD else State.ESTOPPED
    assert bench.mcs.manager.state is expected
    assert not bench.mcs.manager.power
    assert bench.mcs.manager.brakes.all()
    assert not bench.mcs.tau.any()
    delattr(bench.driver, method)
    bench.mcs.tick([])
    assert not bench.driver.drive.power
    if expected is State.ESTOPPED:
        assert bench.ask("reset")["success"]
        bench.to_motion("left")


class Deaf:
    """Power and brakes that do what they want."""

    def __init__(self, driver, **overrides):
        self.driver, self.overrides = driver, overrides

    def __call__(self):
        return type(self.driver).read(self.driver)._replace(**self.overrides)


def test_power_that_does_not_come_is_given_up(bench):
    bring_to(bench, State.RESERVED)
    bench.driver.read = Deaf(bench.driver, power=False)
    reply = bench.ask("power_on")
    assert reply["error"]["code"] == "timeout"
    assert bench.mcs.manager.state is State.RESERVED
    assert not bench.driver.drive.power


def test_power_that_does_not_go_is_an_estop_that_cannot_be_reset(bench):
    bring_to(bench, State.ACTIVE)
    bench.driver.read = Deaf(bench.driver, power=True, brakes=np.ones(18, dtype=bool))
    reply = bench.ask("power_off")
    assert reply["error"]["code"] == "timeout"
    assert bench.mcs.manager.state is State.ESTOPPED
    assert "power is not obeyed" in bench.mcs.manager.cause
    assert "still reports power on" in bench.ask("reset")["error"]["message"]
    del bench.driver.read
    assert bench.ask("reset")["success"]


@pytest.mark.parametrize("obeys", [True, False])
def test_after_an_estop_time_goes_on_until_the_testbed_has_obeyed(bench, obeys):
    """Else what is shown would stay what it was; but not for ever."""
    bring_to(bench, State.MOTION)
    if not obeys:
        bench.driver.read = Deaf(bench.driver, power=True)
    bench.send("estop", reason="test")
    assert bench.mcs.wants_time
    ticks = 0
    while bench.mcs.wants_time:
        bench.mcs.tick([])
        ticks += 1
    servo = bench.mcs.config.servo
    assert ticks <= (2 if obeys else round(servo.answer_timeout_s / servo.period_s))
    assert bench.mcs.measured.power != obeys
    assert not bench.driver.drive.power


def test_brakes_that_do_not_release_hold_before_the_torque_leaves(bench):
    bring_to(bench, State.ACTIVE)
    stuck = np.zeros(18, dtype=bool)
    stuck[9:] = True
    stuck[3] = True
    bench.driver.read = Deaf(bench.driver, brakes=stuck)
    number = bench.send("enable_motion")
    while not bench.driver.drive.brakes[LEFT].all() or bench.mcs.measured.tick < 20:
        bench.mcs.tick([])
    bench.driver.read = Deaf(bench.driver, brakes=np.ones(18, dtype=bool))
    with_torque = 0
    while bench.mcs.wants_time:
        with_torque += bool(bench.mcs.tau.any())
        bench.mcs.tick([])
    assert bench.reply(number)["error"]["code"] == "timeout"
    assert with_torque >= bench.mcs.config.servo.brake_lead_ticks
    assert bench.mcs.manager.state is State.ACTIVE
    assert not bench.mcs.tau.any()
    assert bench.driver.drive.brakes.all()


def test_brakes_that_neither_release_nor_engage_are_an_estop(bench):
    bring_to(bench, State.ACTIVE)
    half = np.ones(18, dtype=bool)
    half[:3] = False
    bench.driver.read = Deaf(bench.driver, brakes=half)
    reply = bench.ask("enable_motion")
    assert reply["error"]["code"] == "timeout"
    assert bench.mcs.manager.state is State.ESTOPPED
    assert "brakes are not obeyed" in bench.mcs.manager.cause


def test_brakes_that_do_not_engage_leave_the_torque_on(bench, model, cell):
    bring_to(bench, State.MOTION)
    loose = np.ones(18, dtype=bool)
    loose[2] = False
    bench.driver.read = Deaf(bench.driver, brakes=loose)
    reply = bench.ask("disable_motion")
    assert reply["error"]["code"] == "timeout"
    assert bench.mcs.manager.state is State.MOTION
    bench.mcs.tick([])
    np.testing.assert_allclose(bench.mcs.tau[LEFT], model.gravity(cell.home)[LEFT], atol=2.0)
    del bench.driver.read
    assert bench.ask("disable_motion")["success"]


def drive(bench, torques, /, **more):
    given = {"group": "left", "kind": "torque", "torques": np.asarray(torques).tolist(), "owner": "ann"}
    return bench.send("stream", **{**given, "lease_s": 0.05, **more})


@pytest.fixture
def owned(bench):
    bench.ask("reserve", group="left", owner="ann")
    for request in ("power_on", "enable_motion"):
        assert bench.ask(request)["success"]
    return bench


def test_the_owner_drives_torques_until_its_lease_lapses(owned, model, cell):
    gravity = model.gravity(cell.home)[LEFT]
    push = gravity.copy()
    push[3] += 5.0
    first = drive(owned, push)
    np.testing.assert_array_equal(owned.driver.drive.tau[LEFT], push)
    for _ in range(20):
        assert owned.reply(drive(owned, push))["success"]
    assert owned.driver.v[3] > 0.05
    assert "driven by torques" in owned.reply(owned.send("move", group="left", path=path(cell)))["error"]["message"]
    while owned.reply(first) is None:
        owned.mcs.tick([])
        assert np.abs(owned.mcs.setpoint[0] - owned.mcs.measured.q).max() < 1e-12
    assert owned.reply(first)["error"]["code"] == "lease"
    held = owned.mcs.setpoint[0].copy()
    while owned.mcs.wants_time:
        owned.mcs.tick([])
    np.testing.assert_allclose(owned.driver.q, held, atol=1e-3)  # no leap: the law holds where the lease lapsed
    assert owned.mcs.manager.state is State.MOTION


def path(cell):
    return {"kind": "joint", "points": [cell.home[LEFT].tolist()]}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"owner": "bob"}, "driven by its owner 'ann' only, not by 'bob'"),
        ({"lease_s": 0.0}, "need a lease"),
        ({"torques": [0.0] * 8}, "8 torques for 9 joints"),
        ({"torques": [0.0] * 8 + [math.nan]}, "left_j6"),
        ({"torques": [0.0] * 8 + ["1"]}, "torques is a list of numbers"),
        ({"kind": "voltage"}, "kind is one of setpoint, torque"),
    ],
)
def test_wrong_torques_are_refused(owned, change, words):
    reply = owned.reply(drive(owned, [0.0] * 9, **change))
    assert words in reply["error"]["message"]
    assert owned.mcs.moving() is None


def test_torques_end_before_the_joint_leaves_its_range_or_is_too_fast(owned, model):
    limits = owned.mcs.limits
    first = None
    for _ in range(3000):
        push = model.gravity(owned.driver.q)[LEFT]
        push[0] += 400.0  # along the track
        number = drive(owned, push)
        first = first or number
        if owned.reply(first) is not None:
            break
    error = owned.reply(first)["error"]
    assert error["code"] == "limit"
    assert "left_track" in error["message"]
    while owned.mcs.wants_time:
        owned.mcs.tick([])
    assert owned.driver.q[0] <= limits.upper[0] + 0.005
    assert owned.mcs.manager.state is State.MOTION


def test_torques_beyond_the_limit_are_cut_and_counted(owned):
    limit = owned.mcs.limits.torque[LEFT]
    drive(owned, limit * 3.0)
    np.testing.assert_array_equal(owned.driver.drive.tau[LEFT], limit)
    assert owned.mcs.saturations.counts[4, LEFT].all()


@pytest.mark.parametrize("request_name", ["estop", "protective_stop"])
def test_stops_end_driving(owned, model, cell, request_name):
    first = drive(owned, model.gravity(cell.home)[LEFT])
    owned.send(request_name, reason="enough")
    assert "enough" in owned.reply(first)["error"]["message"]
    assert not owned.mcs.loop.driving
