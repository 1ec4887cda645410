"""Drivers that fail, and torques that a client drives itself."""

import json
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


@pytest.mark.parametrize("failing", [0, 1])
@pytest.mark.parametrize("method", ["read", "write"])
def test_hardware_whose_driver_works_stops_with_that_whose_driver_fails(halves, failing, method):
    halves.to_motion("left", "right")
    lost, other = halves.drivers[failing], halves.drivers[1 - failing]
    assert other.drive.power
    assert not other.drive.brakes.any()
    setattr(lost, method, raising(LinkError("the cable is cut")))
    with pytest.raises(LinkError, match="the cable is cut") as caught:
        halves.mcs.tick([])
    halves.mcs.lose_testbed(caught.value)
    assert halves.mcs.manager.state is State.ESTOPPED
    assert not other.drive.power
    assert other.drive.brakes.all()
    assert not other.drive.command.any()


@pytest.mark.parametrize("failing", [0, 1])
def test_hardware_is_left_whatever_the_driver_of_other_hardware_does(halves, failing):
    left = []
    for rank, driver in enumerate(halves.drivers):
        driver.close = raising(OSError("no device")) if rank == failing else lambda: left.append("left")
    with pytest.raises(LinkError, match="no device"):
        halves.testbed.close()
    assert left == ["left"]


@pytest.mark.parametrize(
    ("facts", "told"),
    [
        ({"reason": "overvoltage"}, {"reason": "overvoltage"}),
        ({"channel": np.int64(3), "q": np.zeros(2), "bus": ["a", math.nan]}, {"channel": "3", "q": "[0. 0.]"}),
        ({"joints": ["a"], "limit": 0.5, "value": math.inf}, {"joints": ["a"], "limit": 0.5, "value": "inf"}),
    ],
)
def test_what_a_driver_says_of_its_failure_is_told_whatever_it_is(bench, cell, facts, told):
    bench.to_motion("left")
    path = {"kind": "joint", "points": [(cell.home[:9] - 0.1).tolist()]}
    goal = bench.send("move", group="left", path=path)
    bench.mcs.lose_testbed(LinkError("the bus is off", **facts))
    assert bench.mcs.manager.state is State.ESTOPPED
    given = bench.reply(goal)["error"]["facts"]
    assert told.items() <= given.items()
    json.dumps(bench.events, allow_nan=False)


def drive(bench, torques, /, **more):
    given = {"group": "left", "kind": "torque", "torques": np.asarray(torques).tolist(), "owner": "ann"}
    return bench.send("stream", **{**given, "lease_s": 0.05, **more})


ANN = {"names": ["ann"]}


@pytest.fixture
def owned(bench):
    bench.ask("reserve", group="left", owner="ann")
    for request in ("power_on", "enable_motion"):
        assert bench.ask(request, sender=ANN)["success"]
    return bench


def test_the_owner_drives_torques_until_its_lease_lapses(owned, model, cell):
    gravity = model.gravity(cell.home)[LEFT]
    push = gravity.copy()
    push[3] += 5.0
    first = drive(owned, push)
    np.testing.assert_array_equal(owned.driver.drive.command[LEFT], push)
    for _ in range(20):
        assert owned.reply(drive(owned, push))["success"]
    assert owned.driver.v[3] > 0.05
    refused = owned.reply(owned.send("move", group="left", path=path(cell), sender=ANN))
    assert "driven by torques" in refused["error"]["message"]
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
        ({"lease_s": 0.0}, "lease_s 0.0 is not a number above 0 and up to 10 [s]"),
        ({"lease_s": 11.0}, "lease_s 11.0 is not a number above 0 and up to 10 [s]"),
        ({"kind": "setpoint", "positions": [0.0] * 9, "lease_s": 0.0}, "lease_s 0.0 is not a number above 0"),
        ({"torques": [0.0] * 8}, "8 torques for 9 joints"),
        ({"torques": [0.0] * 8 + [math.nan]}, "left_j6"),
        ({"torques": [0.0] * 8 + ["1"]}, "is not a list of numbers"),
        ({"kind": "voltage"}, "kind 'voltage' is not one of setpoint, torque"),
    ],
)
def test_wrong_torques_are_refused(owned, change, words):
    reply = owned.reply(drive(owned, [0.0] * 9, **change))
    assert words in reply["error"]["message"]
    assert owned.mcs.moving(("left", "right")) is None


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
    np.testing.assert_array_equal(owned.driver.drive.command[LEFT], limit)
    assert owned.mcs.saturations.counts[4, LEFT].all()


@pytest.mark.parametrize("request_name", ["estop", "protective_stop"])
def test_stops_end_torque_streams(owned, model, cell, request_name):
    first = drive(owned, model.gravity(cell.home)[LEFT])
    owned.send(request_name, reason="enough")
    assert "enough" in owned.reply(first)["error"]["message"]
    assert not owned.mcs.loop.torque_streams


def setpoint(bench, q):
    return bench.send("stream", group="left", kind="setpoint", positions=q.tolist(), owner="ann", lease_s=0.05)


@pytest.mark.parametrize("kind", ["torque", "setpoint"])
@pytest.mark.parametrize("ending", ["protective_stop", "cancel"])
def test_who_goes_on_streaming_after_a_stop_moves_nothing(owned, model, cell, kind, ending):
    push = model.gravity(cell.home)[LEFT]
    push[3] += 5.0
    target = cell.home[LEFT].copy()
    target[3] += 0.5

    def send():
        return drive(owned, push) if kind == "torque" else setpoint(owned, target)

    first = send()
    for _ in range(20):
        assert owned.reply(send())["success"]
    owned.send(ending, **({"reason": "enough"} if ending == "protective_stop" else {"goal": first}))
    patience = round(owned.mcs.config.protective.patience_s / owned.mcs.config.servo.period_s) + 400
    for _ in range(patience):
        last = send()
        if owned.reply(first) is not None and not owned.mcs.setpoint[1].any():
            break
    stopped = owned.mcs.setpoint[0].copy()
    for _ in range(50):
        last = send()
        np.testing.assert_array_equal(owned.mcs.setpoint[0], stopped)
    error = owned.reply(last)["error"]
    assert error["code"] == "state"
    assert "send nothing for 0.05 s, its lease, or resume the group" in error["message"]
    began = owned.mcs.measured.tick
    while owned.mcs.wants_time:  # at clock factor 0 too his silence comes to its end
        owned.mcs.tick([])
    assert owned.mcs.measured.tick >= began + 10
    if ending == "protective_stop":
        held = owned.reply(send())["error"]["message"]
        assert held == "group 'left' is held by a protective stop (protective stop: enough); resume it"
        assert owned.ask("resume", group="left", sender=ANN)["success"]
    again = send()
    owned.mcs.tick([])
    while owned.mcs.wants_time:
        owned.mcs.tick([])
    assert owned.reply(again)["error"]["code"] == "lease"  # it was taken


def test_a_resumed_group_takes_torques_at_once_and_another_owner_need_not_wait(owned, model, cell):
    push = model.gravity(cell.home)[LEFT]
    drive(owned, push)
    owned.send("protective_stop", reason="enough")
    assert not owned.reply(drive(owned, push))["success"]
    assert owned.ask("resume", group="left", sender=ANN)["success"]
    goal = drive(owned, push)
    assert owned.reply(goal) is None
    assert owned.ask("take_over", group="left", owner="bob", lease_s=0.0, sender={"names": ["bob"]})["success"]
    assert owned.reply(goal)["error"]["code"] == "state"
    assert owned.reply(drive(owned, push, owner="bob")) is None


def test_a_pause_of_all_halts_whoever_is_not_driven_by_torques_and_names_who_is(owned, model, cell):
    bench = owned
    bench.ask("reserve", group="right")
    for request in ("power_on", "enable_motion"):
        bench.ask(request)
    target = cell.home[9:].copy()
    target[3] += 0.5
    bench.send("move", group="right", path={"kind": "joint", "points": [target.tolist()]})
    drive(bench, model.gravity(cell.home)[LEFT], lease_s=5.0)
    for _ in range(20):
        bench.mcs.tick([])
    assert bench.mcs.setpoint[1, 9:].any()
    error = bench.reply(bench.send("pause"))["error"]["message"]
    assert "group 'left' is driven by torques" in error
    assert error.endswith("; right paused")
    for _ in range(200):
        bench.mcs.tick([])
    assert not bench.mcs.setpoint[1, 9:].any()
    assert bench.mcs.groups["right"].paused
    assert bench.mcs.loop.torque_streams.goal("left") is not None
    error = bench.reply(bench.send("pause", group="left"))["error"]["message"]
    assert error.endswith("ask for a protective stop")
