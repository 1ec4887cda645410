"""Whatever a request says: it is answered, and what is wrong changes no state, no setpoint and no torque."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from im_mcs.protocol.points import TimedPoints, pack_points
from im_mcs.state import Event, State

HOME = [-0.6, 0.0, 0.0, 0.0, 1.75, -3.3, 0.0, 0.0, 0.0]
POINTS = TimedPoints(np.array([2.0]), np.array([HOME]), np.zeros((1, 9)), None)
RIGHT = {
    "reserve": {"group": "right", "owner": "tester", "lease_s": 0.0},
    "release": {"group": "right"},
    "renew": {"owner": "nobody"},
    "repartition": {"preset": "3x6"},
    "power_on": {},
    "power_off": {},
    "reset": {},
    "move": {"group": "left", "path": {"kind": "joint", "points": [HOME]}, "policy": "refuse", "speed_scale": 0.5},
    "stream": {"group": "left", "kind": "torque", "torques": [0.0] * 9, "lease_s": 0.1, "owner": ""},
    "cancel": {"goal": 77},
    "pause": {"group": "left"},
    "resume": {"group": "left"},
    "set_speed": {"group": "left", "scale": 0.5},
    "set_gripper": {"gripper": "left_gripper", "opening": 0.01, "force": 1.0},
    "set_controller": {"group": "left", "controller": "im_mcs.control.pid:Pid"},
    "set_payload": {"group": "left", "mass": 1.0, "center": [0.0, 0.0, 0.1], "inertia": [0.0] * 6},
    "protective_stop": {"reason": "test"},
    "estop": {"reason": "test"},
    "enable_motion": {},
    "disable_motion": {},
}
PATHS = [
    {"kind": "joint", "points": [HOME], "blend": 0.0},
    {"kind": "line", "poses": [[0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]], "speed": 0.1, "blend": 0.0},
    {"kind": "trajectory", "points": pack_points(POINTS), "path_tolerance": [0.1] * 9, "goal_velocity_tolerance": []},
]
NAMES = ("group", "preset", "gripper", "controller", "kind", "policy", "request")
"""Arguments that must be one of some names."""
SCALARS = st.none() | st.booleans() | st.sampled_from([math.nan, math.inf, -math.inf, 10**400, -(10**400)])
JUNK = st.recursive(
    SCALARS | st.sampled_from([-1e308, 1e308, -7, 0]) | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=10) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=12,
)
NEVER = SCALARS | st.lists(SCALARS, max_size=10) | st.just({}) | st.just([[[]]])
"""Values that no argument may have: neither texts nor finite numbers."""
SHARED = (HealthCheck.function_scoped_fixture,)
"""All examples are sent to one machine: that is what shows that they leave it as it is."""


@pytest.fixture(scope="module")
def machine():
    """A machine in motion state, made anew where a test changes it."""
    return {}


@pytest.fixture
def moving(machine, bench):
    if not machine:
        bench.to_motion("left")
        machine["bench"] = bench
    return machine["bench"]


def seen(mcs):
    groups = [
        (g.name, g.goals, g.controller.name, g.paused, g.protective, g.rates.override) for g in mcs.groups.values()
    ]
    manager = mcs.manager
    return (
        manager.state,
        manager.power,
        manager.brakes.tolist(),
        manager.reservations.groups,
        mcs.config.preset,
        groups,
        mcs.grippers.opening.tolist(),
        mcs.control_model.changing,
        bool(mcs.loop.torque_streams),
    )


def check_refused(bench, message):
    """Send it; it is answered with a sentence, and nothing has changed."""
    mcs, number = bench.mcs, 1000 + len(bench.events)
    before, tau, setpoint = seen(mcs), mcs.tau.copy(), mcs.setpoint.copy()
    mcs.tick([{"id": number, **message}])
    reply = bench.reply(number)
    for _ in range(200):  # some are taken up, and refused while they are prepared
        if reply is not None:
            break
        mcs.tick([])
        reply = bench.reply(number)
    assert reply is not None, message
    assert not reply["success"], message
    assert len(reply["error"]["message"]) > 10
    assert seen(mcs) == before, message
    np.testing.assert_allclose(mcs.setpoint[0, :9], setpoint[0, :9], atol=1e-12)
    np.testing.assert_allclose(mcs.tau, tau, atol=1e-3 * mcs.limits.torque.min())


@settings(max_examples=150, deadline=None, suppress_health_check=SHARED)
@given(st.data())
def test_an_argument_that_cannot_be_is_refused(moving, data):
    request = data.draw(st.sampled_from([name for name, given in RIGHT.items() if given]))
    name = data.draw(st.sampled_from(sorted(RIGHT[request])))
    wrong = data.draw(JUNK.filter(lambda v: v != "") if name in NAMES else NEVER)
    if request in ("pause", "resume") and wrong == "left":
        return
    check_refused(moving, {"request": request, "arguments": {**RIGHT[request], name: wrong}})


@settings(max_examples=200, deadline=None, suppress_health_check=SHARED)
@given(st.data())
def test_a_path_that_cannot_be_is_refused(moving, data):
    path = data.draw(st.sampled_from(PATHS))
    at = data.draw(st.sampled_from(sorted(path)))
    wrong = data.draw(JUNK if at in ("kind", "points", "poses") else NEVER.filter(lambda v: v != []))
    check_refused(moving, {"request": "move", "arguments": {"group": "left", "path": {**path, at: wrong}}})


@settings(max_examples=100, deadline=None, suppress_health_check=SHARED)
@given(st.data())
def test_a_value_deep_inside_a_path_that_cannot_be_is_refused(moving, data):
    wrong = data.draw(NEVER)
    rank = data.draw(st.integers(0, 8))
    bad = [*HOME[:rank], wrong, *HOME[rank + 1 :]]
    pose = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    pose[rank % 7] = wrong
    paths = [
        {"kind": "joint", "points": [HOME, bad]},
        {"kind": "line", "poses": [pose]},
        *({"kind": "trajectory", "points": {**pack_points(POINTS), name: wrong}} for name in pack_points(POINTS)),
    ]
    if isinstance(wrong, float):
        q = np.array([bad])
        changed = (replace(POINTS, q=q), replace(POINTS, v=q), replace(POINTS, times=np.array([wrong])))
        paths += [{"kind": "trajectory", "points": pack_points(points)} for points in changed]
    path = data.draw(st.sampled_from(paths))
    check_refused(moving, {"request": "move", "arguments": {"group": "left", "path": path}})


@settings(max_examples=150, deadline=None, suppress_health_check=SHARED)
@given(st.dictionaries(st.sampled_from(["request", "arguments", "id", "x"]), JUNK, max_size=4))
def test_a_message_of_anything_never_breaks_the_loop(moving, message):
    before = seen(moving.mcs)
    moving.mcs.tick([message])
    assert seen(moving.mcs) == before
    assert moving.events[-1]["success"] is False


@pytest.mark.parametrize("request_name", RIGHT)
def test_an_argument_too_many_or_too_few_is_named(moving, request_name):
    arguments = RIGHT[request_name]
    check_refused(moving, {"request": request_name, "arguments": {**arguments, "zzz": 1}})
    assert "zzz" in moving.events[-1]["error"]["message"]
    assert moving.mcs.manager.state is State.MOTION
    assert Event(request_name)
