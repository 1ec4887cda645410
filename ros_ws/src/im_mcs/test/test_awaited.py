"""At clock factor 0 time stands for the owner of a group who was answered and has not said yet what is next."""

import types

import numpy as np
import pytest

from im_mcs.servo import awaited
from im_mcs.servo.awaited import AwaitedOwners
from im_mcs.state import State

LEFT, RIGHT = slice(0, 9), slice(9, 18)
STEP = np.array([0.1, 0.2, 0.1, 0.3, -0.2, 0.3, 0.4, 0.4, 0.4])
PATIENCE_S = 0.5


@pytest.fixture
def wall(monkeypatch):
    """Wall time, which the test lets pass."""
    time = types.SimpleNamespace(now=100.0)
    monkeypatch.setattr(awaited, "clock", types.SimpleNamespace(monotonic=lambda: time.now))
    return time


@pytest.fixture
def shared(bench, wall):
    """Both groups in motion, of two owners, on a testbed whose time passes on demand."""
    bench.mcs._awaited = AwaitedOwners(PATIENCE_S)
    for group in ("left", "right"):
        assert bench.ask("reserve", group=group)["success"]
    for request in ("power_on", "enable_motion"):
        assert bench.ask(request)["success"]
    wall.now += PATIENCE_S
    return bench


def to(home, part):
    """A way from home for the joints of a group."""
    return {"kind": "joint", "points": [(home[part] + STEP).tolist()], "blend": 0.0}


def answered(bench, request, **arguments):
    """Whether a request for the right group is done; time passes until then, no longer."""
    number = bench.send(request, group="right", **arguments)
    while bench.reply(number) is None:
        bench.mcs.tick([])
    return bench.reply(number)["success"]


def ticks(bench, count=3):
    for _ in range(count):
        bench.mcs.tick([])


def test_an_owner_is_awaited_from_each_answer_and_not_for_ever(wall):
    owners = AwaitedOwners(PATIENCE_S)
    assert not owners.present
    reserved, active = {"left": State.RESERVED}, {"left": State.ACTIVE}
    owners.update(reserved, set())
    assert owners.present
    wall.now += 0.4
    owners.update(reserved, set())  # nothing new
    owners.update(dict(reserved), {"right"})
    wall.now += 0.2
    assert not owners.present
    owners.update(active, set())
    assert owners.present
    wall.now += 0.6
    owners.update(active, {"left"})
    owners.update({**active, "right": State.RESERVED}, {"left"})
    assert owners.present
    owners.update({**active, "right": State.RESERVED}, {"left", "right"})
    assert not owners.present
    owners.update(active, set())  # it has done what it did
    assert owners.present
    owners.update({}, set())
    assert not owners.present


def test_a_group_that_moves_waits_for_the_owner_of_one_that_has_just_come_to_rest(shared, cell, wall):
    first = shared.send("move", group="left", path=to(cell.home, LEFT))
    ticks(shared)
    assert (shared.mcs.wants_time, shared.mcs.held) == (True, False)  # nobody has said anything for long
    assert shared.driver.drive.wants_time
    assert answered(shared, "disable_motion")
    assert answered(shared, "enable_motion")
    assert (shared.mcs.wants_time, shared.mcs.held) == (True, True)
    assert not shared.driver.drive.wants_time
    shared.send("move", group="right", path=to(cell.home, RIGHT))  # a request is heard in a tick of its own
    ticks(shared)
    assert not shared.mcs.held
    assert shared.driver.drive.wants_time
    assert shared.reply(first) is None


def test_who_has_not_come_in_time_is_not_waited_for(shared, cell, wall):
    shared.send("move", group="left", path=to(cell.home, LEFT))
    ticks(shared)
    assert answered(shared, "disable_motion")
    assert shared.mcs.held
    shared.mcs.go_on()
    assert not shared.driver.drive.wants_time
    wall.now += PATIENCE_S
    shared.mcs.go_on()
    assert (shared.mcs.held, shared.driver.drive.wants_time) == (False, True)
    ticks(shared)
    assert not shared.mcs.held


@pytest.mark.parametrize("urgent", ["gripper", "estop"])
def test_jaws_and_an_emergency_stop_wait_for_nobody(shared, cell, urgent):
    shared.send("move", group="left", path=to(cell.home, LEFT))
    ticks(shared)
    assert answered(shared, "disable_motion")
    assert shared.mcs.held
    if urgent == "gripper":
        shared.send("set_gripper", gripper="left_gripper", opening=0.0)
    else:
        shared.send("estop", reason="test")
    assert not shared.mcs.held


def test_on_a_testbed_whose_time_passes_by_itself_nobody_is_awaited(bench, cell):
    for group in ("left", "right"):
        assert bench.ask("reserve", group=group)["success"]
    for request in ("power_on", "enable_motion"):
        assert bench.ask(request)["success"]
    bench.send("move", group="left", path=to(cell.home, LEFT))
    ticks(bench)
    assert not bench.mcs.held
    assert bench.driver.drive.wants_time
