"""The servo process around MCS, turn by turn: drivers that fail, heartbeats, what it shows."""

import os
import sys
import types

import numpy as np
import pytest

from im_core import clock
from im_mcs.limits.slots import Driver
from im_mcs.protocol.channel import ServoChannel, channel_name
from im_mcs.protocol.evidence import Records
from im_mcs.servo.process import ServoProcess
from im_mcs.state import State
from im_mcs.state.table import STATES
from im_mcs.testbed.loopback import LoopbackDriver

INSTANCE = f"im_mcs_process_{os.getpid()}"


@pytest.fixture
def turns(frictionless, cell, model, monkeypatch, tmp_path, request):
    """A process whose turns the test makes, and its owner's end of the channel; a parameter is the rate of samples."""
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    made = []

    def make():
        made.append(LoopbackDriver(model.inertia_diagonal(cell.home), cell.home, bias=model.gravity))
        return made[-1]

    module = types.ModuleType("test_driver")
    module.make = make
    monkeypatch.setitem(sys.modules, "test_driver", module)
    clock_name = frictionless.testbed.clock
    testbed = frictionless.testbed.model_copy(update={"drivers": {clock_name: Driver(driver="test_driver:make")}})
    safety = frictionless.safety.model_copy(update={"testbed_silence_s": 0.1, "owner_silence_s": 0.2})
    config = frictionless.model_copy(update={"testbed": testbed, "safety": safety})
    config = config.at_sample_rate(getattr(request, "param", 50.0))
    channel = ServoChannel.create(channel_name(INSTANCE), ServoChannel.layout(config))
    process = ServoProcess(INSTANCE, config)
    process.driver, process.owner, process.seen = made[-1], channel, []
    yield process
    process._mcs.close()
    process._channel.close()
    channel.close()


def turn(process, count=1, beat=True):
    for _ in range(count):
        if beat:
            process.owner.heartbeat.beat()
        process._turn()
        process.seen += process.owner.events.receive_all()


def ask(process, number, request, **arguments):
    process.owner.requests.send({"id": number, "request": request, "arguments": arguments})
    for _ in range(600):
        turn(process)
        for event in process.seen:
            if event["event"] == "reply" and event["id"] == number:
                return event
    raise AssertionError(f"{request} was not answered")


def to_motion(process):
    for number, request, given in ((1, "reserve", {"group": "left"}), (2, "power_on", {}), (3, "enable_motion", {})):
        assert ask(process, number, request, **given)["success"]


def raising(error):
    def call(*_):
        raise error

    return call


@pytest.mark.parametrize("fault", [RuntimeError, SystemExit])
@pytest.mark.parametrize("method", ["wait", "read", "write"])
def test_a_driver_that_fails_is_an_estop_and_requests_are_refused_until_it_is_back(turns, method, fault):
    to_motion(turns)
    setattr(turns.driver, method, raising(fault("a bug")))
    turn(turns)
    snapshot = turns.owner.snapshot.read()
    assert STATES[int(snapshot["state"])] is State.ESTOPPED
    assert not snapshot["linked"]
    told = [event for event in turns.seen if event["event"] == "state"][-1]
    assert told["state"] == "estopped"
    assert "a bug" in told["reason"]
    assert not ask(turns, 9, "reset")["success"]
    delattr(turns.driver, method)
    turns.driver.connect = raising(OSError("not yet"))
    message = ask(turns, 10, "reset")["error"]["message"]
    assert message == "the testbed does not answer: the channel driver failed: connect: OSError: not yet"
    del turns.driver.connect
    turn(turns)  # power off and brakes on reach the driver
    assert ask(turns, 11, "reset")["success"]
    assert turns.owner.snapshot.read()["linked"]


def test_an_owner_who_takes_nothing_loses_progress_and_nothing_else(turns):
    to_motion(turns)
    turns.seen.clear()
    numbers = range(100, 1200)
    far = turns._mcs.measured.q[:9] + 0.3
    path = {"kind": "joint", "points": [far.tolist()]}
    turns.owner.requests.send({"id": 10, "request": "move", "arguments": {"group": "left", "path": path}})
    for number in numbers:
        turns.owner.heartbeat.beat()
        turns.owner.requests.send({"id": number, "request": "jump", "arguments": {}})
        turns._pending += [{"event": "progress", "id": 10}] * 9
        turns._turn()
    assert turns._mcs.manager.state is State.MOTION
    assert turns._reporter.linked
    assert turns.owner.events.filled > 0.9
    assert 0 < len(turns._pending) < len(numbers)
    turns.owner.requests.send({"id": 2000, "request": "estop", "arguments": {"reason": "a hand"}})
    turn(turns, 10)
    told = [event for event in turns.seen if event["event"] != "progress"]
    assert [event["id"] for event in told if event["event"] == "reply" and event["id"] >= 100] == [*numbers, 2000]
    assert [event["state"] for event in told if event["event"] == "state"] == ["estopped"]
    assert told.index(next(e for e in told if e["event"] == "state")) > len(numbers)
    assert 100 < len(turns.seen) - len(told) < 9 * len(numbers)


def test_answers_that_had_to_wait_come_while_time_stands(turns):
    to_motion(turns)
    turns.seen.clear()
    text = 200 * "x"
    while turns.owner.events.filled < 0.99:
        turns._channel.events.send({"event": "progress", "id": 1, "text": text})
    for number in range(10, 20):
        turns.owner.requests.send({"id": number, "request": "spring", "arguments": {}})
    turns._turn()
    assert turns._pending
    turns.seen += turns.owner.events.receive_all()
    ticks = iter((False, True))
    turns.driver.wait = lambda timeout_s: next(ticks)
    turns._wait()
    turns.seen += turns.owner.events.receive_all()
    assert [event["id"] for event in turns.seen if event["event"] == "reply"] == list(range(10, 20))


def test_a_testbed_that_stops_ticking_is_noticed_only_while_time_must_pass(turns, cell):
    to_motion(turns)
    turns.driver.wait = lambda timeout_s: clock.sleep(0.01) or False
    turns._mcs.wants_time = True
    turn(turns)
    told = [event for event in turns.seen if event["event"] == "state"][-1]
    assert "the testbed has not ticked for" in told["reason"]
    assert turns._mcs.manager.state is State.ESTOPPED
    assert not turns._mcs.wants_time


def test_a_testbed_that_stands_for_an_owner_who_is_awaited_is_not_silent_and_goes_on_without_him(turns):
    to_motion(turns)
    mcs, whole, waits = turns._mcs, turns.driver.wait, []
    mcs._awaited = types.SimpleNamespace(present=True, update=lambda states, busy: None)
    mcs.wants_time = mcs.held = True

    def wait(timeout_s):
        waits.append(timeout_s)
        clock.sleep(0.01)  # in all longer than a testbed may be silent
        mcs._awaited.present = len(waits) < 30
        return not mcs.held and whole(timeout_s)

    turns.driver.wait = wait
    tick = mcs.measured.tick
    turn(turns)
    assert mcs.manager.state is State.MOTION
    assert mcs.measured.tick > tick
    assert len(waits) >= 30


def test_a_servo_that_waited_for_the_processor_itself_does_not_blame_the_testbed(turns, monkeypatch):
    to_motion(turns)
    passed, whole = [0.0], turns.driver.wait

    def wait(timeout_s):
        if passed[0] == 0.0:
            passed[0] = 3.0  # woken that late, while the testbed had no processor either
            return False
        return whole(timeout_s)

    later = types.SimpleNamespace(monotonic=lambda: clock.monotonic() + passed[0], sleep=clock.sleep)
    monkeypatch.setattr("im_core.patience.clock", later)
    turns.driver.wait = wait
    turns._mcs.wants_time = True
    tick = turns._mcs.measured.tick
    turn(turns)
    assert turns._mcs.manager.state is State.MOTION
    assert turns._mcs.measured.tick == tick + 1


def test_a_request_is_not_kept_waiting_by_a_testbed_that_does_not_tick(turns):
    """Nor is a testbed blamed whose time stands still because nobody asked for any."""
    asked = clock.monotonic() + 0.3

    def wait(timeout_s):
        if clock.monotonic() > asked and turns.owner.requests.empty() and not turns.seen:
            turns.seen.append({"event": "asked"})
            turns.owner.requests.send({"id": 7, "request": "reset", "arguments": {}})
        return clock.sleep(0.01) or False

    turns.driver.wait = wait
    began = clock.monotonic()
    turn(turns)
    assert clock.monotonic() - began > 0.4
    reply = next(event for event in turns.seen if event.get("id") == 7)
    assert "the testbed does not answer: the testbed has not ticked for " in reply["error"]["message"]


def test_a_testbed_that_nobody_has_asked_for_time_yet_is_not_blamed_for_a_request_that_waits(turns):
    """Its sender has written it, and was then kept from the processor."""
    turns.owner.requests.send({"id": 7, "request": "reserve", "arguments": {"group": "left"}})
    looks, whole = [], turns.driver.wait

    def wait(timeout_s):
        clock.sleep(0.01)
        return len(looks) > 40 and whole(timeout_s)

    turns.driver.time_asked = lambda: looks.append(0) or False
    turns.driver.wait = wait
    turn(turns)
    reply = next(event for event in turns.seen if event.get("id") == 7)
    assert reply["success"], reply


def test_a_silent_owner_is_stopped_for_and_power_goes(turns):
    to_motion(turns)
    deadline = clock.monotonic() + 60.0
    while turns._mcs.manager.state is not State.RESERVED and clock.monotonic() < deadline:
        turn(turns, beat=False)
    assert turns._mcs.manager.state is State.RESERVED
    told = [event for event in turns.seen if event["event"] == "state"][-1]
    assert told["reason"] == "the process that owns the servo gave no heartbeat for 0.2 s"
    assert ask(turns, 5, "power_on")["success"]
    assert turns.seen[-2]["reason"] == ""  # the owner is there again, and knows
    turn(turns)
    assert ask(turns, 6, "power_off")["success"]
    assert not turns.driver.drive.power
    assert turns.driver.drive.brakes.all()


def test_the_owner_sees_the_servo_s_signs_of_life(turns):
    turn(turns, 3)
    assert turns.owner.heartbeat.silence_s() == 0.0
    clock.sleep(0.05)
    assert turns.owner.heartbeat.silence_s() >= 0.05
    turn(turns)
    assert turns.owner.heartbeat.silence_s() == 0.0


def test_snapshot_samples_and_evidence(turns, cell):
    to_motion(turns)
    ask(turns, 4, "set_speed", group="left", scale=0.5)
    point = (cell.home[:9] + 0.1).tolist()
    turns.owner.requests.send(
        {"id": 5, "request": "move", "arguments": {"group": "left", "path": {"kind": "joint", "points": [point]}}}
    )
    turn(turns, 80)
    turns.owner.requests.send({"id": 6, "request": "protective_stop", "arguments": {"reason": "a hand"}})
    turn(turns, 120)
    snapshot = turns.owner.snapshot.read()
    left, right = snapshot["groups"][0], snapshot["groups"][1]
    assert (left["name"], right["name"]) == (b"left", b"right")
    assert (bool(left["reserved"]), bool(right["reserved"])) == (True, False)
    assert bool(left["moving"])
    assert b"a hand" in left["protective_stop"]
    assert left["speed"] == 0.0
    assert left["controller"].decode().endswith(":PidGravity")
    assert snapshot["preset"] == b"2x9"
    assert snapshot["distance"] < 10.0
    np.testing.assert_array_equal(snapshot["setpoint"], turns._mcs.setpoint[0])
    record = Records(turns.owner.evidence).read(int(snapshot["evidence"]))
    assert np.abs(record["setpoint_v"][-1, :9]).max() > 0.0

    samples = turns.owner.samples.take_samples()
    assert len(samples) > 30
    np.testing.assert_allclose(np.diff([s["stamp_ns"] for s in samples]), 20e6, atol=4.6e6)
    assert {"q", "v", "tau", "age", "setpoint_q", "setpoint_v", "setpoint_a", "wrench", "gripper"} <= samples[-1].keys()
    assert len(samples[-1]["wrench"]) == 2
    assert turns.owner.samples.take_samples() == []


@pytest.mark.parametrize(("turns", "step_ns"), [(10.0, 100e6), (250.0, 4.5e6)], indirect=["turns"])
def test_samples_come_at_the_rate_of_the_configuration_and_once_a_tick_at_most(turns, step_ns):
    to_motion(turns)
    turns.owner.samples.take_samples()
    turns._mcs.wants_time = True
    turn(turns, 100)
    steps = np.diff([sample["stamp_ns"] for sample in turns.owner.samples.take_samples()])
    assert len(steps) >= 3
    np.testing.assert_allclose(steps, step_ns, atol=4.6e6 if step_ns > 4.5e6 else 1.0)


def test_a_slow_owner_loses_the_oldest_samples_only(turns):
    to_motion(turns)
    turns._mcs.wants_time = True
    turn(turns, 1000)
    samples = turns.owner.samples.take_samples()
    assert len(samples) < 130
    assert samples[-1]["stamp_ns"] >= turns._mcs.measured.stamp_ns - 25_000_000
    assert (np.diff([s["tick"] for s in samples]) > 0).all()
