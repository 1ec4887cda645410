"""Owners and leases of reservations, and other partitions of the joints without a restart."""

import numpy as np
import pytest

from im_core.errors import NotFoundError, StateError
from im_mcs.protocol.requests import Sender
from im_mcs.state import Reservations, State

LEFT = slice(0, 9)
ANN = Sender(names=["ann"])


def joint_path(*points):
    return {"kind": "joint", "points": [np.asarray(point).tolist() for point in points]}


def refused(reply, *words):
    assert not reply["success"]
    for word in words:
        assert word in reply["error"]["message"]


def test_a_slot_has_one_owner():
    groups = Reservations({"left": ["a", "b"], "right": ["c"], "both": ["b", "c"]})
    groups.reserve("left", "ann")
    with pytest.raises(StateError, match=r"'both' \(owner 'bob'\) .* 'b' is owned by group 'left' \(owner 'ann'\)"):
        groups.reserve("both", "bob")
    groups.reserve("right")
    assert groups.groups == ("left", "right")
    with pytest.raises(StateError, match="reserved already by owner 'ann'"):
        groups.reserve("left", "bob")
    groups.release("left")
    with pytest.raises(StateError, match=r"'left' is not reserved \(reserved: right\)"):
        groups.release("left")
    with pytest.raises(NotFoundError, match="did you mean 'left'"):
        groups.reserve("lefft")


def test_a_lease_runs_from_receipt_and_is_renewed():
    groups = Reservations({"left": ["a"], "right": ["b"]})
    groups.reserve("left", "ann", lease_s=1.0, now_ns=10**9)
    groups.reserve("right", "bob")
    assert groups.lapse(2 * 10**9) == []
    groups.renew("ann", 2 * 10**9)
    assert groups.lapse(3 * 10**9) == []
    assert [r.group for r in groups.lapse(3 * 10**9 + 1)] == ["left"]
    assert groups.lapse(4 * 10**9) == []  # told once
    with pytest.raises(StateError, match=r"'left' .owner 'ann'. has lapsed"):
        groups.require_driver("left", ANN)
    with pytest.raises(StateError, match=r"owner 'eve' has reserved no group .owners: 'ann', 'bob'"):
        groups.renew("eve", 0)
    groups.renew("ann", 4 * 10**9)
    groups.require_driver("left", ANN)
    with pytest.raises(StateError, match="driven by its owner 'ann' only, not by 'bob'"):
        groups.require_driver("left", Sender(names=["bob"]))


@pytest.mark.parametrize(("owner", "name"), [("/teleop", "teleop"), ("teleop", "/teleop")])
def test_an_owner_is_the_same_with_and_without_the_slash_of_a_node(owner, name):
    groups = Reservations({"left": ["a"]})
    groups.reserve("left", owner, lease_s=1.0, now_ns=0)
    groups.renew(name, 10**9)
    assert groups.lapse(2 * 10**9) == []
    groups.require_driver("left", Sender(names=[name]))


def test_leases_of_two_owners_that_lapse_together_are_both_told():
    groups = Reservations({"left": ["a"], "right": ["b"], "third": ["c"]})
    for group, owner in (("left", "ann"), ("right", "bob"), ("third", "ann")):
        groups.reserve(group, owner, lease_s=1.0)
    assert [r.group for r in groups.lapse(2 * 10**9)] == ["left", "third"]
    assert [r.group for r in groups.lapse(2 * 10**9)] == ["right"]
    assert groups.lapse(2 * 10**9) == []


LAW = "im_mcs.control.computed_torque:ComputedTorque"
BY_ANN = {"names": ["ann"]}
CHANGES = {
    "move": {"path": None},
    "stream": {"kind": "setpoint", "positions": None, "lease_s": 0.1},
    "resume": {},
    "set_speed": {"scale": 0.5},
    "set_controller": {"controller": LAW},
    "set_payload": {"mass": 1.0, "center": [0.0, 0.0, 0.1], "inertia": [0.0] * 6},
    "disable_motion": {},
    "power_off": {},
    "power_on": {},
    "enable_motion": {},
    "release": {},
}
BEFORE = {"release": 0, "power_on": 0, "enable_motion": 1, "power_off": 1}
"""How much of power and motion there must be before a request; else both."""
"""What only the owner of a group may ask, and how."""


def asked_by(request, names, client, cell):
    """Arguments of a request of somebody; a stream names its owner itself."""
    given = {"group": "left", **CHANGES[request]}
    if request == "move":
        given["path"] = joint_path(cell.home[LEFT] + 0.01)
    if request == "stream":
        return {**given, "positions": cell.home[LEFT].tolist(), "owner": names[0] if names else ""}
    return {**given, "sender": {"names": names, "client": client}}


@pytest.mark.parametrize("request_name", CHANGES)
@pytest.mark.parametrize(("names", "client"), [(["bob", "/bob"], "0b"), ([], "0b"), ([], ""), (["an"], "")])
def test_a_stranger_neither_moves_nor_changes_nor_releases_a_group(bench, cell, request_name, names, client):
    bench.ask("reserve", group="left", owner="ann", sender={"client": "0a"})
    for request in ("power_on", "enable_motion")[: BEFORE.get(request_name, 2)]:
        assert bench.ask(request, sender=BY_ANN)["success"]
    before = bench.mcs.setpoint.copy()
    asked = asked_by(request_name, names, client, cell)
    refused(bench.ask(request_name, **asked), "group 'left' is driven by its owner 'ann' only", "/mcs/take_over")
    assert bench.mcs.manager.reservations.of("left").owner == "ann"
    np.testing.assert_array_equal(bench.mcs.setpoint, before)


@pytest.mark.parametrize("request_name", [name for name in CHANGES if name != "stream"])
@pytest.mark.parametrize(("names", "client"), [(["ann"], ""), ([], "0a"), (["/x/y", "/ann"], "0b")])
def test_the_owner_is_known_by_name_and_by_the_process_that_reserved(bench, cell, request_name, names, client):
    bench.ask("reserve", group="left", owner="ann", sender={"client": "0a"})
    for request in ("power_on", "enable_motion")[: BEFORE.get(request_name, 2)]:
        assert bench.ask(request, sender=BY_ANN)["success"]
    reply = bench.ask(request_name, **asked_by(request_name, names, client, cell))
    assert reply["success"], reply


def test_anyone_may_stop_what_another_moves(bench, cell):
    bench.ask("reserve", group="left", owner="ann", sender={"client": "0a"})
    bench.ask("power_on", sender=BY_ANN)
    bench.ask("enable_motion", sender=BY_ANN)
    for stop in ("pause", "protective_stop", "estop"):
        given = {"group": "left"} if stop == "pause" else {"reason": "a hand"}
        assert bench.reply(bench.send(stop, **given))["success"]


@pytest.mark.parametrize("preset", ["2x9", "3x6", "1x18"])
def test_a_gripper_is_driven_by_the_owner_of_its_arm_and_by_the_nodes_that_are_named(make_bench, frictionless, preset):
    bench = make_bench(frictionless.with_preset(preset))
    group = "testbed" if preset == "1x18" else "left"
    bench.ask("reserve", group=group, owner="ann", sender={"client": "0a"})
    bench.ask("power_on", sender=BY_ANN)
    for sender, served in (
        ({"client": "0b", "names": ["/bob"]}, False),
        ({}, False),
        (BY_ANN, True),
        ({"client": "0a"}, True),
        ({"names": ["/gripper_coordinator"]}, True),
    ):
        reply = bench.ask("set_gripper", gripper="left_gripper", opening=0.0, sender=sender)
        assert reply["success"] == served, reply
        assert served or f"group '{group}' is driven by its owner 'ann' only" in reply["error"]["message"]
    right = bench.ask("set_gripper", gripper="right_gripper", opening=0.0)
    assert right["success"] == (preset != "1x18")  # nobody has reserved that arm


@pytest.mark.parametrize("steps", [0, 1, 2, 3])
def test_a_protective_stop_is_latched_in_every_state(bench, cell, steps):
    ways = (("reserve", {"group": "left"}), ("power_on", {}), ("enable_motion", {}))
    for request, given in ways[:steps]:
        assert bench.ask(request, **given)["success"]
    assert bench.ask("protective_stop", reason="a hand")["success"]
    assert not bench.mcs.wants_time
    assert all(group.protective for group in bench.mcs.groups.values())
    for request, given in ways[steps:]:
        assert bench.ask(request, **given)["success"]
    near = cell.home[LEFT] + 0.05
    for policy in ("refuse", "append", "replace"):
        refused(bench.move("left", near, policy=policy), "held by a protective stop (protective stop: a hand)")
    assert bench.ask("resume")["success"]
    assert bench.move("left", near)["success"]
    assert not any(group.protective for group in bench.mcs.groups.values())  # those that nobody has reserved, too


def test_a_protective_stop_outlives_a_partition_and_ends_with_a_reset(bench, cell):
    bench.ask("protective_stop", reason="a hand")
    assert bench.ask("repartition", preset="3x6")["success"]
    bench.to_motion("left")
    near = cell.home[3:9] + 0.05
    refused(bench.move("left", near), "a hand")
    bench.ask("estop", reason="another")
    assert bench.ask("reset")["success"]
    bench.to_motion("left")
    assert bench.move("left", near)["success"]


def test_an_operator_takes_a_group_over_and_gives_it_back(bench, cell):
    bench.ask("reserve", group="left", owner="ann", lease_s=5.0, sender={"client": "0a"})
    bench.ask("power_on", sender=BY_ANN)
    bench.ask("enable_motion", sender=BY_ANN)
    far = joint_path(cell.home[LEFT] + 0.3)
    mine = bench.send("move", group="left", path=far, sender={"names": ["ann"]})
    for _ in range(200):
        bench.mcs.tick([])
    refused(bench.reply(bench.send("take_over", group="right", owner="bob")), "'right' is not reserved")
    assert bench.reply(mine) is None
    taken = bench.ask("take_over", group="left", owner="bob", sender={"client": "0b"})
    assert taken["results"] == {"owner": "ann"}
    refused(bench.reply(mine), "group 'left' was taken over for 'bob'")
    assert bench.mcs.manager.state is State.MOTION
    assert bench.mcs.groups["left"].monitor.at_rest
    refused(bench.ask("move", group="left", path=far, sender={"names": ["ann"], "client": "0a"}), "its owner 'bob'")
    assert bench.ask("move", group="left", path=far, sender={"client": "0b"})["success"]
    assert bench.ask("take_over", group="left", owner="")["results"] == {"owner": "bob"}
    assert bench.ask("move", group="left", path=joint_path(cell.home[LEFT]))["success"]


@pytest.mark.parametrize("request_name", ["reserve", "take_over"])
def test_a_lease_or_a_name_beyond_all_bounds_is_refused_in_short(bench, request_name):
    bench.ask("reserve", group="right")
    for lease_s in (1e308, 2e6):
        refused(bench.ask(request_name, group="left", lease_s=lease_s), f"lease_s {lease_s!r} is not", "up to 1e+06")
    for name in ("group", "owner"):
        reply = bench.ask(request_name, **{"group": "right", name: "x" * 2**20})
        refused(reply, f"{name} 'xxxx", "is not a text of up to 256 characters")
        assert len(reply["error"]["message"]) < 120
    assert bench.mcs.manager.reservations.groups == ("right",)


def test_a_dead_client_s_groups_stop_on_the_path_and_hold(bench, cell):
    bench.ask("reserve", group="left", owner="planner", lease_s=0.4)
    bench.ask("reserve", group="right", owner="other")
    for owner in ("planner", "other"):
        for request in ("power_on", "enable_motion"):
            assert bench.ask(request, sender={"names": [owner]})["success"]
    bench.ask("renew", owner="planner")
    far, home = cell.home[LEFT] + 0.3, cell.home[9:] + 0.1
    planner, other = {"names": ["planner"]}, {"names": ["other"]}
    mine = bench.send("move", group="left", path=joint_path(far, cell.home[LEFT], far), sender=planner)
    other = bench.ask("move", group="right", path=joint_path(home), sender=other)
    assert other["success"]
    error = bench.reply(mine)["error"]
    assert error["code"] == "lease"
    assert "owner 'planner'" in error["message"]
    assert bench.reply(mine)["results"]["evidence"] >= 1
    assert bench.mcs.manager.state is State.MOTION
    assert bench.mcs.groups["left"].monitor.at_rest
    refused(bench.ask("move", group="left", path=joint_path(far), sender=planner), "'planner'", "has lapsed")
    assert bench.ask("renew", owner="planner")["success"]
    again = bench.send("move", group="left", path=joint_path(cell.home[LEFT]), sender=planner)
    assert bench.reply(again) is None


def test_without_power_a_lapsed_reservation_is_freed(bench):
    bench.ask("reserve", group="left", owner="planner", lease_s=0.05)
    refused(bench.ask("reserve", group="left", owner="other"), "reserved already by owner 'planner'")
    for _ in range(15):
        bench.mcs.tick([])
    assert bench.mcs.manager.state is State.COLD
    assert bench.ask("reserve", group="left", owner="other")["success"]


def test_repartition_in_cold_and_in_reserved(bench, frictionless):
    assert bench.ask("repartition", preset="3x6")["success"]
    assert set(bench.mcs.groups) == {"left", "right", "transporter"}
    assert bench.ask("reserve", group="left")["success"]
    refused(bench.ask("repartition", preset="2x9"), "2x9", "'left' reserved", "release first")
    assert bench.mcs.config.preset == "3x6"
    refused(bench.ask("repartition", preset="2x8"), "no preset '2x8'", "2x9")
    assert bench.ask("release", group="left")["success"]
    assert bench.ask("repartition", preset="1x18")["success"]
    assert bench.mcs.manager.state is State.COLD
    bench.to_motion("testbed")
    assert not bench.driver.drive.brakes.any()


def test_a_group_that_both_partitions_have_stays_reserved_and_stays_itself(config, frictionless, make_bench):
    presets = dict(frictionless.presets)
    presets["pair"] = {"left": presets["3x6"]["left"], "carts": presets["3x6"]["transporter"]}
    bench = make_bench(frictionless.model_copy(update={"presets": presets, "preset": "3x6"}))
    bench.ask("reserve", group="left", owner="ann")
    bench.ask("set_speed", group="left", scale=0.5, sender={"names": ["ann"]})
    left = bench.mcs.groups["left"]
    assert bench.ask("repartition", preset="pair")["success"]
    assert bench.mcs.groups["left"] is left
    assert bench.mcs.manager.reservations.of("left").owner == "ann"
    assert bench.mcs.manager.state is State.RESERVED
    refused(bench.ask("reserve", group="transporter"), "no group 'transporter'", "carts")
    assert bench.ask("reserve", group="carts")["success"]
    assert bench.ask("power_on")["success"]


def test_arms_at_rest_change_hands_under_power_without_a_bump(frictionless, make_bench, cell):
    bench = make_bench(frictionless.with_preset("2x9"), gravity=1.1)  # a tenth of it is the integrals' work
    for group, lease_s in (("left", 0.0), ("right", 500.0)):
        assert bench.ask("reserve", group=group, owner="ann", lease_s=lease_s)["success"]
    for request in ("power_on", "enable_motion"):
        assert bench.ask(request, sender=BY_ANN)["success"]
    bench.ask("set_speed", group="right", scale=0.5, sender=BY_ANN)
    near = cell.home + 0.04
    for group, index in (("left", slice(0, 9)), ("right", slice(9, 18))):
        assert bench.ask("move", group=group, path=joint_path(near[index]), sender=BY_ANN)["success"]
    steps = []
    q, held, tau = bench.driver.q.copy(), bench.mcs.setpoint[0].copy(), bench.mcs.tau.copy()

    def look():
        nonlocal tau
        assert bench.driver.drive.power
        assert not bench.driver.drive.brakes.any()
        assert bench.mcs.manager.state is State.MOTION
        steps.append(np.abs(bench.mcs.tau - tau) / bench.mcs.limits.torque)
        tau = bench.mcs.tau.copy()

    for preset, names in (("1x18", {"testbed"}), ("3x6", {"left", "right", "transporter"}), ("2x9", {"left", "right"})):
        assert bench.ask("repartition", look, preset=preset, sender=BY_ANN)["success"]
        assert set(bench.mcs.manager.states) == set(bench.mcs.groups) == names
        assert {bench.mcs.manager.reservations.of(name).owner for name in names} == {"ann"}
        assert {bench.mcs.manager.reservations.of(name).lease_s for name in names} == {500.0}
        while bench.mcs.wants_time:
            bench.mcs.tick([])
            look()
        np.testing.assert_array_equal(bench.mcs.setpoint[0], held)
        np.testing.assert_allclose(bench.driver.q, q, atol=1e-4)
    assert np.max(steps) < 2e-3  # of the largest torque, in a tick
    assert not bench.mcs.saturations.counts.any()
    whole = bench.ask("repartition", preset="1x18", sender=BY_ANN)
    assert whole["success"], whole["error"]
    durations = []
    for point in (cell.home, near):
        whole = bench.ask("move", group="testbed", path=joint_path(point), sender=BY_ANN)
        assert whole["success"], whole["error"]
        durations.append(whole["results"]["duration"])
        bench.ask("set_speed", group="testbed", scale=1.0, sender=BY_ANN)
    assert durations[0] > 1.5 * durations[1]  # of two speeds the slower one
    assert bench.ask("power_off", sender=BY_ANN)["success"]
    assert not bench.driver.drive.power


def test_what_cannot_change_hands_under_power_is_refused_and_stays(bench, cell):
    bench.ask("reserve", group="left", owner="ann")
    by_bob, preset = {"names": ["bob"]}, "1x18"
    refused(bench.ask("repartition", preset=preset, sender=BY_ANN), "'left' reserved", "'testbed' has right_track")
    bench.ask("reserve", group="right", owner="bob")
    for sender in (BY_ANN, by_bob, {"names": ["ann", "bob"]}):
        refused(bench.ask("repartition", preset=preset, sender=sender), "owner")
    bench.ask("release", group="right", sender=by_bob)
    bench.ask("reserve", group="right", owner="ann")
    for request in ("power_on", "enable_motion"):
        assert bench.ask(request, group="left", sender=BY_ANN)["success"]
    refused(bench.ask("repartition", preset=preset, sender=BY_ANN), "'left' is motion, 'right' is reserved")
    bench.ask("power_on", group="right", sender=BY_ANN)
    released = bench.send("enable_motion", group="right", sender=BY_ANN)
    asked = bench.send("repartition", preset=preset, sender=BY_ANN)
    refused(bench.reply(asked), "while enable_motion is under way")
    while bench.reply(released) is None:
        bench.mcs.tick([])
    moving = bench.send("move", group="left", path=joint_path(cell.home[LEFT] + 0.2), sender=BY_ANN)
    refused(bench.ask("repartition", preset=preset, sender=BY_ANN), "'left', 'right' not at rest")
    while bench.reply(moving) is None:
        bench.mcs.tick([])
    assert bench.reply(moving)["success"]
    assert bench.mcs.config.preset == "2x9"
    assert bench.ask("repartition", preset=preset, sender=BY_ANN)["success"]


@pytest.mark.parametrize("preset", ["3x6", "2x9", "1x18"])
def test_all_groups_of_a_partition_move_at_once(frictionless, make_bench, cell, preset):
    bench = make_bench(frictionless.with_preset(preset))
    bench.to_motion(*frictionless.presets[preset])
    target = cell.home - 0.04 * (cell.home > 0)
    numbers = [
        bench.send("move", group=name, path=joint_path(target[group.index])) for name, group in bench.mcs.groups.items()
    ]
    moving = []
    while bench.mcs.wants_time:
        bench.mcs.tick([])
        moving.append(sum(not group.planner.still for group in bench.mcs.groups.values()))
    assert max(moving) == len(numbers)
    assert all(bench.reply(number)["success"] for number in numbers)
    np.testing.assert_allclose(bench.driver.q, target, atol=1e-4)
    assert not bench.mcs.saturations.counts.any()
