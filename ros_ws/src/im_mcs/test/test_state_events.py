"""Every state and every request, through the whole of MCS."""

import math

import pytest

from im_mcs.state import TABLE, Event, State
from im_mcs.state.table import TRANSITIONS, allowed_in
from im_mcs.testbed.driver import ReportedFault

LAW = "im_mcs.control.computed_torque:ComputedTorque"
WAYS = {
    State.COLD: [],
    State.RESERVED: ["reserve"],
    State.ACTIVE: ["reserve", "power_on"],
    State.MOTION: ["reserve", "power_on", "enable_motion"],
    State.ESTOPPED: ["reserve", "estop"],
}
EVENTS = [event for event in Event if event not in (Event.CONFIGURE, Event.CLEANUP)]
ROWS = {(row.source, row.event): row.target for row in TABLE}


BY = {"sender": {"names": ["tester"]}}


def arguments(event, q, state=None):
    return {
        **dict.fromkeys(TRANSITIONS, BY),
        Event.RESERVE: {"group": "left", "owner": "tester"},
        Event.RELEASE: {"group": "left", **BY},
        Event.TAKE_OVER: {"group": "left", "owner": "other"},
        Event.RESUME: BY,
        Event.RENEW: {"owner": "tester"},
        Event.REPARTITION: {"preset": "3x6" if state is State.COLD else "2x9"},
        Event.MOVE: {"group": "left", "path": {"kind": "joint", "points": [(q + 0.05).tolist()]}, **BY},
        Event.STREAM: {"group": "left", "kind": "setpoint", "positions": q.tolist(), "owner": "tester", "lease_s": 0.1},
        Event.QUERY: {"group": "left", "stamp_ns": 0},
        Event.CANCEL: {"goal": 77},
        Event.SET_SPEED: {"group": "left", "scale": 0.5, **BY},
        Event.SET_GRIPPER: {"gripper": "left_gripper", "opening": 0.01, **BY},
        Event.SET_CONTROLLER: {"group": "left", "controller": LAW, **BY},
        Event.SET_PAYLOAD: {"group": "left", "mass": 1.0, "center": [0, 0, 0.1], "inertia": [0.0] * 6, **BY},
        Event.PROTECTIVE_STOP: {"reason": "test"},
        Event.ESTOP: {"reason": "test"},
    }.get(event, {})


def bring_to(bench, state, q):
    for request in WAYS[state]:
        assert bench.ask(request, **arguments(Event(request), q))["success"]
    assert bench.mcs.manager.state is state


def seen(mcs):
    """Everything that a request may change."""
    return (
        mcs.manager.state,
        mcs.manager.power,
        mcs.manager.brakes.tolist(),
        mcs.manager.busy,
        [vars(mcs.manager.reservations.of(group)).copy() for group in mcs.manager.reservations.groups],
        mcs.config.preset,
        [(g.name, g.goals, g.controller.name, g.paused, g.protective, g.rates.override) for g in mcs.groups.values()],
        mcs.grippers.opening.tolist(),
        mcs.control_model.changing,
        mcs.wants_time,
    )


@pytest.mark.parametrize("state", WAYS)
def test_a_request_without_a_row_is_refused_and_changes_nothing(bench, cell, state):
    q = cell.home[:9]
    bring_to(bench, state, q)
    for event in EVENTS:
        if (state, event) in ROWS:
            continue
        before = seen(bench.mcs)
        given = arguments(event, q, state)
        reply = bench.reply(bench.send(event.value, **given))
        assert not reply["success"], event
        message = reply["error"]["message"]
        if event is Event.RESERVE and state is not State.ESTOPPED:
            assert message == "group 'left' is reserved already by owner 'tester'"
            continue
        named = "group" in given and state not in (State.COLD, State.ESTOPPED)
        whose = " of group 'left'" if named else ""
        assert message.startswith(f"{event.value}{whose} is refused in state {state.value}; allowed here: "), message
        for allowed in allowed_in(state):
            assert allowed.value in message
        assert reply["error"]["facts"]["state"] == state.value
        assert seen(bench.mcs) == before, event


@pytest.mark.parametrize(("state", "event"), [row for row in ROWS if row[0] in WAYS and row[1] in EVENTS])
def test_a_request_with_a_row_leads_where_it_says(bench, cell, state, event):
    q = cell.home[:9]
    bring_to(bench, state, q)
    given = arguments(event, q, state)
    if event is Event.CANCEL:
        under_way = Event.MOVE if state is State.MOTION else Event.SET_GRIPPER
        given = {"goal": bench.send(under_way.value, **arguments(under_way, q))}
    if event is Event.QUERY:
        bench.send("move", **arguments(Event.MOVE, q))
        for _ in range(5):
            bench.mcs.tick([])
        given = {"group": "left", "stamp_ns": bench.mcs.measured.stamp_ns}
    reply = bench.ask(event.value, **given)
    ended_by_lease = event is Event.STREAM  # nobody sends a second setpoint
    assert reply["success"] != ended_by_lease, reply
    assert not ended_by_lease or reply["error"]["code"] == "lease"
    assert bench.mcs.manager.state is ROWS[state, event]
    assert bench.mcs.manager.power == (bench.mcs.manager.state in (State.ACTIVE, State.MOTION))


def test_the_machine_is_cold_when_the_last_group_is_released(bench):
    for group in ("left", "right"):
        bench.ask("reserve", group=group)
    assert bench.ask("release", group="left")["success"]
    assert bench.mcs.manager.state is State.RESERVED
    assert bench.ask("release", group="right")["success"]
    assert bench.mcs.manager.state is State.COLD


HEARD = (Event.ESTOP, Event.PROTECTIVE_STOP, Event.RENEW, Event.SURROUND)


@pytest.mark.parametrize("event", [event for event in EVENTS if event not in HEARD])
def test_while_a_transition_is_under_way_only_stops_renew_and_surroundings_are_heard(bench, cell, event):
    bench.ask("reserve", group="left", owner="tester")
    bench.ask("power_on", **BY)
    bench.send("enable_motion", **BY)
    assert bench.mcs.manager.busy
    before = seen(bench.mcs)
    reply = bench.reply(bench.send(event.value, **arguments(event, cell.home[:9])))
    assert not reply["success"]
    assert seen(bench.mcs)[0] == before[0]
    assert bench.ask("renew", owner="tester")["success"]
    assert bench.mcs.manager.state is State.MOTION


def test_reset_names_what_is_broken_and_what_stopped(bench):
    bench.to_motion("left")
    bench.ask("estop", reason="a hand")
    assert bench.ask("estop", reason="another")["success"]
    assert "a hand" in bench.mcs.manager.cause
    home = bench.driver.q.copy()
    bench.driver.q[4] = math.nan
    bench.driver.faults = lambda: [ReportedFault("brake_stuck", 10), ReportedFault("power_loss")]
    message = bench.ask("reset")["error"]["message"]
    assert "no reading of left_j2, power_loss, brake_stuck of right_rotation; the cause of the stop: a hand" in message
    assert bench.mcs.manager.state is State.ESTOPPED
    bench.driver.q[:] = home
    bench.driver.faults = list
    assert bench.ask("reset")["success"]
    assert bench.mcs.manager.state is State.COLD


def test_an_emergency_stop_overtakes_a_reset(bench):
    bench.to_motion("left")
    bench.ask("estop", reason="a hand")
    reset = bench.send("reset")
    assert bench.mcs.manager.busy
    assert bench.ask("estop", reason="again")["success"]
    assert "emergency stop: again" in bench.reply(reset)["error"]["message"]
    assert bench.mcs.manager.state is State.ESTOPPED
    assert bench.ask("reset")["success"]
