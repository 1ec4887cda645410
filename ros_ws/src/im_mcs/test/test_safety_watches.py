"""Every fault that a watch looks for, injected into a machine that moves."""

import math

import numpy as np
import pytest

from im_mcs.state import State

LEFT = slice(0, 9)


class Fault:
    """A driver that reads something wrong, once told to."""

    def __init__(self, driver):
        self.driver = driver
        self.read = lambda measured: measured

    def __call__(self):
        return self.read(type(self.driver).read(self.driver))


@pytest.fixture
def moving(bench, cell):
    """A machine whose left group is on its way, and what is wrong with it."""
    bench.fault = Fault(bench.driver)
    bench.driver.read = bench.fault
    bench.to_motion("left")
    points = [(cell.home[LEFT] + 0.4).tolist(), cell.home[LEFT].tolist()] * 3
    bench.goal = bench.send("move", group="left", path={"kind": "joint", "points": points})
    for _ in range(120):
        bench.mcs.tick([])
    assert np.abs(bench.mcs.setpoint[1, LEFT]).max() > 0.05
    return bench


def changed(joint, **values):
    def read(measured):
        fields = {}
        for name, value in values.items():
            array = getattr(measured, name).copy()
            array[joint] = value if not callable(value) else value(array[joint])
            fields[name] = array
        return measured._replace(**fields)

    return read


def owner_silent(bench):
    bench.mcs.situation.owner_silence_s = 60.0


def overruns(bench):
    bench.mcs.situation.overruns = bench.mcs.config.servo.max_overruns


def fall_silent(age_s):
    def inject(bench):
        bench.fault.read = changed(4, age_s=age_s)

    return inject


def read(**values):
    return lambda bench: setattr(bench.fault, "read", changed(4, **values))


def cut_power(bench):
    bench.driver.drive = bench.driver.drive._replace(power=False)


def wrong_law(bench):
    group = bench.mcs.groups["left"]
    group.controller._present.law._law.torque = lambda given: np.full(9, math.nan)


def wrong_setpoint(bench):
    planner = bench.mcs.groups["left"].planner
    advance = planner.advance

    def broken():
        setpoint = advance()
        return setpoint._replace(v=setpoint.v * math.nan)

    planner.advance = broken


@pytest.mark.parametrize(
    ("inject", "words"),
    [
        (cut_power, "the testbed cut the power at tick"),
        (read(q=math.nan), "left_j2 gave no reading at tick"),
        (read(q=lambda q: q + 0.3), "left_j2: velocity"),
        (read(q=lambda q: np.degrees(q) + 90.0), " rad, far outside its range, -0.7854 to 3.927 rad"),
        (fall_silent(0.2), "the reading of left_j2 is 0.2 s old"),
        (read(q=lambda q: q + 0.01), None),
        (wrong_law, "returned nan as torque of joint 1 of 9"),
        (wrong_setpoint, "left_track: the setpoint"),
    ],
)
def test_an_estop_acts_in_the_tick_of_its_cause(moving, inject, words):
    mcs, tick = moving.mcs, moving.mcs.measured.tick
    inject(moving)
    mcs.tick([])
    if words is None:  # small enough to be nobody's affair
        assert mcs.manager.state is State.MOTION
        return
    assert mcs.manager.state is State.ESTOPPED
    drive = moving.driver.drive
    assert not drive.power
    assert drive.brakes.all()
    assert not drive.command.any()
    assert mcs.measured.tick == tick + 1
    assert words in mcs.manager.cause
    reply = moving.reply(moving.goal)
    assert "emergency stop" in reply["error"]["message"]
    record = moving.records.read(reply["results"]["evidence"])
    assert record["tick"][-1] == mcs.measured.tick


def test_a_joint_whose_reading_comes_back_is_watched_as_before(moving):
    """One reading that is not a number does not leave its velocity without one."""
    read(q=math.nan)(moving)
    moving.mcs.tick([])
    assert np.isnan(moving.mcs.v).tolist() == [rank == 4 for rank in range(18)]
    moving.fault.read = lambda measured: measured
    assert moving.ask("reset")["success"]
    moving.to_motion("left")
    np.testing.assert_allclose(moving.mcs.v, 0.0, atol=1e-3)
    read(q=lambda q: q + 0.3)(moving)
    moving.mcs.tick([])
    assert "left_j2: velocity" in moving.mcs.manager.cause


@pytest.mark.parametrize(
    ("inject", "clear", "code"),
    [
        (fall_silent(0.05), True, "link"),
        (overruns, True, "overrun"),
        (lambda bench: bench.send("protective_stop", reason="somebody comes"), False, "protective_stop"),
    ],
)
def test_a_protective_stop_decelerates_on_the_path_and_is_resumed(moving, inject, clear, code):
    mcs = moving.mcs
    group = mcs.groups["left"]
    inject(moving)
    mcs.tick([])
    if clear:
        moving.fault.read = lambda measured: measured
        mcs.situation.overruns = 0
    assert mcs.manager.state is State.MOTION
    assert group.protective.code == code
    limit = mcs.limits.ceiling
    last = mcs.setpoint.copy()
    for _ in range(400):
        mcs.tick([])
        assert (np.abs(mcs.setpoint[2, LEFT]) <= limit.acceleration[LEFT] * 1.001).all()
        assert np.abs(mcs.setpoint[0] - last[0] - 0.0045 * last[1]).max() < 1e-3
        last = mcs.setpoint.copy()
    assert not last[1:, LEFT].any()
    assert moving.reply(moving.goal) is None  # suspended
    record = moving.records.read(group.protective.facts["evidence"])
    assert len(record["tick"]) > 100
    assert moving.ask("resume")["success"]
    assert moving.reply(moving.goal)["success"]


def test_patience_over_the_goal_ends_with_the_fault_and_its_evidence(moving):
    moving.send("protective_stop", reason="somebody comes")
    while moving.mcs.wants_time:
        moving.mcs.tick([])
    reply = moving.reply(moving.goal)
    assert reply["error"]["code"] == "protective_stop"
    assert "somebody comes" in reply["error"]["message"]
    assert moving.records.read(reply["results"]["evidence"]) is not None
    assert moving.mcs.groups["left"].monitor.at_rest


@pytest.mark.parametrize(("bound", "state"), [(0.2, State.MOTION), (0.004, State.ESTOPPED)])
def test_a_following_error_is_a_protective_stop_and_twice_its_bound_an_estop(moving, bound, state):
    """A joint that jams: with a tight bound the motion has not stopped before the error is twice that."""
    mcs = moving.mcs
    mcs.limits.following_error[4] = bound
    jammed = moving.driver.q[4]
    stopped = None
    for _ in range(300):
        moving.driver.q[4], moving.driver.v[4] = jammed, 0.0
        mcs.tick([])
        stopped = stopped or mcs.groups["left"].protective
    assert mcs.manager.state is state
    assert stopped.facts["joint"] == "left_j2"
    assert "left_j2: following error at tick" in stopped.message
    assert moving.records.read(stopped.facts["evidence"]) is not None
    if state is State.ESTOPPED:
        assert "left_j2: following error at tick" in mcs.manager.cause


def test_without_its_owner_the_machine_stops_and_switches_itself_off(moving):
    mcs = moving.mcs
    owner_silent(moving)
    for _ in range(4000):
        mcs.tick([])
        if mcs.manager.state is State.RESERVED:
            break
        if mcs.manager.state is State.MOTION:
            assert not moving.driver.drive.brakes[LEFT].all() or not np.abs(mcs.setpoint[1]).any()
    assert mcs.manager.state is State.RESERVED
    assert "no heartbeat for 60 s" in moving.reply(moving.goal)["error"]["message"]
    assert moving.driver.drive.brakes.all()
    assert not moving.driver.drive.power
    assert not mcs.wants_time


def test_bodies_that_come_close_slow_the_motion_down_and_stop_it_with_the_pair_named(bench, cell):
    bench.to_motion("left")
    group, mcs = bench.mcs.groups["left"], bench.mcs
    into = cell.home[LEFT].copy()
    into[4] = -0.77  # the forearm comes down on the platform
    goal = bench.send("move", group="left", path={"kind": "joint", "points": [into.tolist()]})
    slowest, least = 1.0, math.inf
    for _ in range(3000):
        mcs.tick([])
        least = min(least, mcs.loop.proximity.distance)
        if group.protective is not None:
            break
        slowest = min(slowest, mcs.loop.proximity.speed_ceiling)
    fault = group.protective
    assert fault is not None
    assert fault.code == "collision"
    assert fault.facts["first"] in fault.message
    assert fault.facts["second"] in fault.message
    assert slowest < 0.5
    for _ in range(600):
        mcs.tick([])
        least = min(least, mcs.loop.proximity.distance)
    assert least > 0.0
    assert bench.reply(goal) is None
    number = bench.send("cancel", goal=goal)
    assert bench.reply(number)["success"]
    while mcs.wants_time:
        mcs.tick([])
    assert bench.move("left", cell.home[LEFT])["success"]  # the way back is free
