"""The whole of MCS, tick by tick, over the loopback driver."""

import math

import numpy as np
import pytest

from im_core.errors import LinkError, StateError
from im_mcs.protocol.requests import request_message
from im_mcs.state import State

LEFT = slice(0, 9)


def joint_path(*points):
    return {"kind": "joint", "points": [list(map(float, point)) for point in points]}


@pytest.fixture
def target(cell):
    return cell.home[LEFT] + np.array([0.1, 0.2, 0.1, 0.3, -0.2, 0.3, 0.4, 0.4, 0.4])


def refused(reply, *words):
    assert not reply["success"]
    for word in words:
        assert word in reply["error"]["message"]


def test_from_cold_to_a_move_and_back(bench, cell, target):
    mcs = bench.mcs
    assert mcs.manager.state is State.COLD
    bench.ask("reserve", group="left")
    assert mcs.manager.state is State.RESERVED
    assert not bench.driver.drive.power
    bench.ask("power_on")
    assert mcs.manager.state is State.ACTIVE
    assert bench.driver.drive.power
    assert bench.driver.drive.brakes.all()
    bench.ask("enable_motion")
    assert mcs.manager.state is State.MOTION
    assert not bench.driver.drive.brakes[LEFT].any()
    assert bench.driver.drive.brakes[9:].all()
    reply = bench.move("left", target)
    assert reply["success"], reply
    assert reply["results"]["duration"] > 0.5
    np.testing.assert_allclose(bench.driver.q[LEFT], target, atol=1e-4)
    assert mcs.groups["left"].monitor.at_rest
    assert bench.ask("disable_motion")["success"]
    assert bench.driver.drive.brakes.all()
    assert not bench.driver.drive.command.any()
    assert bench.ask("power_off")["success"]
    assert bench.ask("release", group="left")["success"]
    assert mcs.manager.state is State.COLD


def test_gravity_torque_is_there_before_the_brakes_release(bench, model, cell):
    bench.ask("reserve", group="left")
    bench.ask("power_on")
    bench.send("enable_motion")
    seen = []
    while bench.mcs.wants_time:
        drive = bench.driver.drive
        seen.append((bool(drive.brakes[LEFT].any()), drive.command[LEFT].copy()))
        bench.mcs.tick([])
    with_brakes = [tau for braked, tau in seen if braked]
    assert len(with_brakes) >= bench.mcs.config.servo.brake_lead_ticks
    for tau in with_brakes:
        np.testing.assert_allclose(tau, model.gravity(cell.home)[LEFT], atol=1e-6)
    np.testing.assert_allclose(bench.driver.q, cell.home, atol=1e-6)


def test_estop_acts_in_the_same_tick_and_reset_moves_nothing(bench, cell, target):
    bench.to_motion("left")
    goal = bench.send("move", group="left", path=joint_path(target))
    for _ in range(80):
        bench.mcs.tick([])
    number = bench.send("estop", reason="red button")
    drive = bench.driver.drive
    assert not drive.power
    assert drive.brakes.all()
    assert not drive.command.any()
    assert bench.reply(number)["success"]
    refused(bench.reply(goal), "emergency stop: red button")
    assert bench.mcs.manager.state is State.ESTOPPED
    where = bench.driver.q.copy()
    refused(bench.ask("power_on"), "power_on", "estopped", "reset")
    assert bench.ask("reset")["success"]
    assert bench.mcs.manager.state is State.COLD
    bench.to_motion("left")
    np.testing.assert_allclose(bench.driver.q, where, atol=1e-6)  # the arm never leaps
    assert bench.move("left", target)["success"]


@pytest.mark.parametrize("request_name", ["power_on", "enable_motion"])
def test_estop_interrupts_a_transition(bench, request_name):
    bench.ask("reserve", group="left")
    if request_name == "enable_motion":
        bench.ask("power_on")
    else:
        bench.driver.drive = bench.driver.drive._replace(power=False)
    number = bench.send(request_name)
    assert bench.reply(number) is None
    bench.mcs.tick(
        [{"id": 99, "request": request_name}, {"id": 100, "request": "estop", "arguments": {"reason": "hand"}}]
    )
    refused(bench.reply(99), f"{request_name} is refused while {request_name} is under way")
    refused(bench.reply(number), "emergency stop: hand")
    assert bench.mcs.manager.state is State.ESTOPPED
    assert not bench.driver.drive.power


def test_two_groups_move_at_once(bench, cell, target):
    bench.to_motion("left", "right")
    right = cell.home[9:] + np.array([-0.1, 0.1, 0.0, 0.2, 0.1, 0.1, 0.1, 0.1, 0.1])
    a = bench.send("move", group="left", path=joint_path(target))
    b = bench.ask("move", group="right", path=joint_path(right), speed_scale=0.5)
    assert bench.reply(a)["success"]
    assert b["success"]
    np.testing.assert_allclose(bench.driver.q, [*target, *right], atol=1e-4)


def test_a_move_through_points_reports_progress(bench, cell, target):
    bench.to_motion("left")
    home = cell.home[LEFT]
    reply = bench.ask("move", group="left", path=joint_path(target, home, target))
    assert reply["success"]
    told = [e for e in bench.events if e["event"] == "progress"]
    assert [e["progress"] for e in told] == sorted(e["progress"] for e in told)
    assert {e["point"] for e in told} == {0, 1, 2}


def test_cancel_decelerates_and_a_second_goal_is_refused(bench, cell, target):
    bench.to_motion("left")
    goal = bench.send("move", group="left", path=joint_path(target))
    for _ in range(60):
        bench.mcs.tick([])
    refused(bench.reply(bench.send("move", group="left", path=joint_path(target))), "is moving")
    limit = bench.mcs.limits.motion.acceleration[LEFT]
    bench.send("cancel", goal=goal)
    last = bench.mcs.groups["left"].planner.setpoint.v
    while bench.mcs.wants_time:
        bench.mcs.tick([])
        v = bench.mcs.groups["left"].planner.setpoint.v
        assert (np.abs(v - last) <= 1.05 * limit * 0.0045 + 1e-9).all()
        last = v
    refused(bench.reply(goal), "cancelled")
    assert bench.reply(goal)["error"]["code"] == "cancelled"
    assert bench.mcs.groups["left"].monitor.at_rest
    refused(bench.ask("cancel", goal=goal), f"goal {goal} is not under way")


@pytest.mark.parametrize(
    ("request_name", "state"),
    [("disable_motion", State.ACTIVE), ("power_off", State.RESERVED), ("release", State.COLD)],
)
@pytest.mark.parametrize("kind", ["move", "paused", "torque"])
def test_what_takes_motion_or_power_ends_the_goal_at_rest_first(bench, cell, model, target, request_name, state, kind):
    bench.to_motion("left")
    if kind == "torque":
        tau = model.gravity(cell.home)[LEFT].tolist()
        goal = bench.send("stream", group="left", kind="torque", torques=tau, lease_s=5.0)
    else:
        goal = bench.send("move", group="left", path=joint_path(target))
    for _ in range(60):
        bench.mcs.tick([])
    if kind == "paused":
        bench.ask("pause")
    limit = bench.mcs.limits.motion.acceleration[LEFT]
    number = bench.send(request_name, **({"group": "left"} if request_name == "release" else {}))
    last = bench.mcs.groups["left"].planner.setpoint.v
    while bench.reply(number) is None:
        bench.mcs.tick([])
        v = bench.mcs.groups["left"].planner.setpoint.v
        assert (np.abs(v - last) <= 1.05 * limit * 0.0045 + 1e-9).all()
        assert not last.any() or not bench.mcs.manager.brakes[LEFT].any()
        last = v
    assert bench.reply(number)["success"]
    refused(bench.reply(goal), "the motion was ended: motion of its group is being disabled")
    assert bench.mcs.manager.state is state
    assert bench.mcs.manager.power == (state is State.ACTIVE)
    assert bench.mcs.manager.brakes.all()


def heard_together(bench, *requests):
    """Requests of one tick, as a servo hears them that was late; their numbers are 101, 102, ..."""
    together = [{"id": 101 + i, "request": name, "arguments": given} for i, (name, given) in enumerate(requests)]
    bench.mcs.tick(together)
    return [bench.reply(message["id"]) for message in together]


def test_what_is_cancelled_already_when_it_is_heard_is_not_begun(bench, target):
    """Whoever asked for it has been told that it failed."""
    power, cancel = heard_together(bench, ("reserve", {"group": "left", "owner": "me"}), ("cancel", {"goal": 101}))
    refused(power, "the request was cancelled before its start")
    assert cancel["success"]
    assert bench.mcs.manager.state.value == "cold"
    bench.to_motion("left")
    move, cancel = heard_together(
        bench, ("move", {"group": "left", "path": joint_path(target)}), ("cancel", {"goal": 101})
    )
    assert (move["error"]["code"], cancel["success"]) == ("cancelled", True)
    assert not bench.mcs.wants_time


@pytest.mark.parametrize("stop", ["estop", "protective_stop"])
def test_a_stop_that_is_heard_late_is_a_stop_all_the_same(bench, target, stop):
    bench.to_motion("left")
    goal = bench.send("move", group="left", path=joint_path(target))
    for _ in range(60):
        bench.mcs.tick([])
    stopped, cancel = heard_together(bench, (stop, {"reason": "by hand"}), ("cancel", {"goal": 101}))
    assert stopped["success"]
    refused(cancel, "goal 101 is not under way" if stop == "protective_stop" else "estopped")
    while bench.mcs.wants_time and stop == "estop":
        bench.mcs.tick([])
    assert bench.reply(goal) is None if stop == "protective_stop" else not bench.reply(goal)["success"]


@pytest.mark.parametrize("goal", [0, -101, None, 101.0, True, "101", [101]])
def test_what_cancels_nothing_withdraws_nothing(bench, goal):
    reserved, _ = heard_together(bench, ("reserve", {"group": "left", "owner": "me"}), ("cancel", {"goal": goal}))
    assert reserved["success"]


def with_joint(target, i, value):
    return [*target[:i], value, *target[i + 1 :]]


def path(*points, **more):
    return {"path": joint_path(*points), **more}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: path(with_joint(t, 3, 3.5)), ["left_j1", "3.5", "2.78", "rad"]),
        (lambda t: path(with_joint(t, 0, math.nan)), ["left_track", "nan", "finite"]),
        (lambda t: path(t, t[:8]), ["point 2", "8 positions", "9 joints"]),
        (lambda t: path(), ["0 points"]),
        (lambda t: path(*[t] * 201), ["201 points"]),
        (lambda t: path(t, speed_scale=1.5), ["speed_scale", "1.5"]),
        (lambda t: path(t, policy="perhaps"), ["policy", "append", "'perhaps'"]),
        (lambda t: {"path": {"kind": "circle"}}, ["path", "kind 'circle' is not one of joint, line, trajectory"]),
        (lambda t: path(t, group="right"), ["'right' is not reserved", "left"]),
        (lambda t: path(t, group="lefft"), ["lefft", "did you mean 'left'"]),
    ],
)
def test_wrong_moves_are_refused_and_nothing_moves(bench, cell, target, change, words):
    bench.to_motion("left")
    before = bench.driver.q.copy()
    refused(bench.ask("move", **{"group": "left", **change(target)}), *words)
    assert not bench.mcs.wants_time
    for _ in range(5):
        bench.mcs.tick([])
    np.testing.assert_allclose(bench.driver.q, before, atol=1e-6)
    assert bench.mcs.manager.state is State.MOTION


def test_unknown_requests_and_arguments_are_refused(bench):
    refused(bench.ask("dance"), "no request 'dance'")
    refused(bench.ask("reserve"), "reserve takes group, [owner], [lease_s], [sender], not none")
    refused(bench.ask("power_on", loud=True), "power_on takes [group], [sender], not loud")
    refused(bench.ask("reset", loud=True), "reset takes no arguments, not loud")


def test_a_jammed_joint_stops_the_motion_and_is_named(bench, cell, target):
    bench.to_motion("left")
    goal = bench.send("move", group="left", path=joint_path(target))
    for _ in range(1500):
        bench.driver.q[5] = cell.home[5]
        bench.driver.v[5] = 0.0
        bench.mcs.tick([])
        if bench.reply(goal) is not None:
            break
    error = bench.reply(goal)["error"]
    assert error["facts"]["joint"] == "left_j3"
    assert "following error at tick" in error["message"]
    assert "rad is beyond the limit" in error["message"]


def test_power_loss_and_missing_readings_are_estops(bench, cell):
    bench.to_motion("left")
    bench.driver.drive = bench.driver.drive._replace(power=False)
    bench.mcs.tick([])
    assert bench.mcs.manager.state is State.ESTOPPED
    assert "cut the power at tick" in bench.mcs.manager.cause
    bench.ask("reset")
    bench.to_motion("left")
    bench.driver.q[4] = math.nan
    bench.mcs.tick([])
    assert bench.mcs.manager.state is State.ESTOPPED
    assert "left_j2 gave no reading" in bench.mcs.manager.cause
    assert not bench.driver.drive.command.any()


def test_a_lost_testbed_ends_the_goal(bench, target):
    bench.to_motion("left")
    goal = bench.send("move", group="left", path=joint_path(target))
    bench.mcs.lose_testbed(LinkError("the testbed's physics process is gone"))
    refused(bench.reply(goal), "physics process is gone")
    assert bench.mcs.manager.state is State.ESTOPPED
    assert bench.mcs.manager.lost
    bench.ask("reset")
    bench.ask("reserve", group="left")
    bench.mcs.estop(StateError("a hand"))
    assert not bench.mcs.manager.lost
    bench.mcs.lose_testbed(LinkError("the testbed's physics process is gone"))
    assert not bench.mcs.manager.lost  # stopped before for another reason


def test_an_emergency_stop_is_obeyed_while_the_testbed_is_away(bench):
    """It was refused like all else, and the arms moved when the testbed was back."""
    bench.mcs.lose_testbed(LinkError("the testbed's physics process is gone"))
    away = LinkError("the testbed does not answer")
    bench.mcs.refuse(request_message(1001, "estop", {"reason": "a hand"}), away)
    bench.mcs.refuse(request_message(1002, "reserve", {"group": "left"}), away)
    assert bench.reply(1001)["success"]
    refused(bench.reply(1002), "does not answer")
    bench.mcs.find_testbed()
    bench.mcs.tick([])
    assert bench.mcs.manager.state is State.ESTOPPED
    refused(bench.ask("reserve", group="left"), "a hand")


def test_jaws_of_another_testbed_stay_where_they_are(bench):
    """Not where those of the one before were told to be: the first setpoint is where it is."""
    for request, given in (("reserve", {"group": "left"}), ("power_on", {})):
        assert bench.ask(request, **given)["success"]
    assert bench.ask("set_gripper", gripper="left_gripper", opening=0.02)["success"]
    bench.mcs.lose_testbed(LinkError("the testbed's physics process is gone"))
    bench.mcs.find_testbed()
    bench.mcs.tick([])
    assert bench.driver.drive.gripper[0] == pytest.approx(0.02), "they are where they were"
    bench.mcs.lose_testbed(LinkError("the testbed's physics process is gone"))
    bench.driver.drive = bench.driver.drive._replace(gripper=np.array([0.08, 0.08]))
    bench.mcs.find_testbed()
    bench.mcs.tick([])
    assert bench.driver.drive.gripper[0] == pytest.approx(0.08)


def test_a_pause_ends_with_who_had_the_group(bench, target):
    bench.to_motion("left")
    assert bench.ask("pause", group="left")["success"]
    for request in ("disable_motion", "power_off"):
        assert bench.ask(request)["success"]
    assert bench.ask("release", group="left")["success"]
    bench.to_motion("left")
    assert bench.move("left", target)["success"]


def test_grippers(bench):
    bench.ask("reserve", group="left")
    refused(bench.ask("set_gripper", gripper="left_gripper", opening=0.02), "set_gripper", "reserved")
    bench.ask("power_on")
    refused(bench.ask("set_gripper", gripper="left_griper", opening=0.02), "did you mean 'left_gripper'")
    refused(bench.ask("set_gripper", gripper="left_gripper", opening=0.2), "0.2 m", "0.08 m")
    reply = bench.ask("set_gripper", gripper="left_gripper", opening=0.02)
    assert reply["results"]["opening"] == pytest.approx(0.02)


@pytest.mark.parametrize("preset", ["3x6", "1x18"])
def test_other_partitions(config, frictionless, model, cell, bench, preset):
    from_bench = type(bench)(frictionless.with_preset(preset), model, bench.driver)
    from_bench.to_motion(*frictionless.presets[preset])
    for name, group in from_bench.mcs.groups.items():
        assert from_bench.move(name, cell.home[group.index] - 0.02 * (cell.home[group.index] > 0))["success"]
