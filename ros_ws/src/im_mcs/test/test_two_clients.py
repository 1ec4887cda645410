"""One client's group moves; another client reserves, powers, moves and releases its own meanwhile."""

import numpy as np
import pytest

LEFT, RIGHT = slice(0, 9), slice(9, 18)
ANN, BOB = {"sender": {"names": ["ann"]}}, {"sender": {"names": ["bob"]}}
STEP = np.array([0.1, 0.3, 0.1, 0.4, -0.3, 0.4, 0.5, 0.5, 0.5])
LAW = "im_mcs.control.pid_gravity:PidGravity"


def path(*points):
    return {"kind": "joint", "points": [point.tolist() for point in points]}


def all_that_bob_may_ask(home):
    """Everything that can be asked for a group, in an order that the table allows."""
    near = path(home[RIGHT] + 0.05)
    return [
        ("reserve", {"owner": "bob"}),
        ("set_controller", {"controller": LAW, **BOB}),
        ("power_on", BOB),
        ("set_payload", {"mass": 1.0, "center": [0, 0, 0.05], "inertia": [0.0] * 6, **BOB}),
        ("enable_motion", BOB),
        ("set_payload", {"mass": 0.0, "center": [0, 0, 0], "inertia": [0.0] * 6, **BOB}),
        ("set_speed", {"scale": 0.7, **BOB}),
        ("move", {"path": near, **BOB}),
        ("pause", {}),
        ("resume", BOB),
        ("disable_motion", BOB),
        ("power_off", BOB),
        ("release", BOB),
    ]


def run(bench, home, questions):
    """A move of the left arm there and back, twice: setpoints, torques and readings, shape (m, 5, 9), and its answer.

    Args:
        bench: The machine.
        home: Where it stands.
        questions: What is asked for the right arm meanwhile, each when the one before is answered.
    """
    assert bench.ask("reserve", group="left", owner="ann")["success"]
    for request in ("power_on", "enable_motion"):
        assert bench.ask(request, group="left", **ANN)["success"]
    far = home[LEFT] + STEP
    goal, asked, rows = bench.send("move", group="left", path=path(*[far, home[LEFT]] * 2), **ANN), None, []
    questions = list(questions)
    while bench.reply(goal) is None:
        if questions and (asked is None or bench.reply(asked)):
            request, given = questions.pop(0)
            asked = bench.send(request, group="right", **given)
        else:
            bench.mcs.tick([])
        mcs = bench.mcs
        rows.append([*mcs.setpoint[:, LEFT], mcs.tau[LEFT], mcs.measured.q[LEFT]])
        reply = asked and bench.reply(asked)
        assert not reply or reply["success"], reply
    assert not questions, "the left arm had ended before all was asked"
    return np.array(rows), bench.reply(goal)


def test_what_another_client_asks_for_its_group_leaves_a_moving_group_as_it_is(make_bench, frictionless, cell):
    """Bit by bit; but vector instructions round the model's torques by where in memory numbers lie."""
    alone, ended_alone = run(make_bench(frictionless), cell.home, [])
    beside, ended = run(make_bench(frictionless), cell.home, all_that_bob_may_ask(cell.home))
    assert ended["success"]
    assert ended["results"] == ended_alone["results"]
    np.testing.assert_array_equal(beside[:, :3], alone[:, :3])
    np.testing.assert_allclose(beside[:, 3:], alone[:, 3:], rtol=0.0, atol=1e-9)


def test_over_the_testbed_s_physics_too(config, plant_bench, cell):
    alone, ended_alone = run(plant_bench(config, 3), cell.home, [])
    beside, ended = run(plant_bench(config, 3), cell.home, all_that_bob_may_ask(cell.home))
    assert ended["success"]
    assert ended["results"] == ended_alone["results"]
    np.testing.assert_array_equal(beside[:, :3], alone[:, :3])
    counts = (beside[:, 4] - alone[:, 4]) / cell.per_joint("resolution")[LEFT]
    assert np.abs(counts).max() < 3.0  # of the encoders: what a bit of rounding becomes where it meets their edges


def test_a_group_that_joins_begins_where_it_is_measured(make_bench, frictionless, cell):
    bench = make_bench(frictionless)
    bench.to_motion("left")
    goal = bench.send("move", group="left", path=path(cell.home[LEFT] + STEP))
    for request in ("reserve", "power_on", "enable_motion"):
        number = bench.send(request, group="right")
        while bench.reply(number) is None:
            was = bench.mcs.groups["right"].engaged
            bench.mcs.tick([])
            if bench.mcs.groups["right"].engaged and not was:
                np.testing.assert_array_equal(bench.mcs.setpoint[0, RIGHT], bench.mcs.measured.q[RIGHT])
                assert not bench.mcs.setpoint[1:, RIGHT].any()
        assert bench.reply(number)["success"]
    assert bench.reply(goal) is None
    assert bench.mcs.groups["right"].engaged


def test_two_moves_at_once_take_as_long_as_the_longer_one(make_bench, frictionless, cell):
    def ticks(*groups):
        bench = make_bench(frictionless)
        bench.to_motion("left", "right")
        began = bench.mcs.measured.tick
        targets = {"left": cell.home[LEFT] + STEP, "right": cell.home[RIGHT] - 0.5 * STEP}
        numbers = [bench.send("move", group=group, path=path(targets[group])) for group in groups]
        while any(bench.reply(number) is None for number in numbers):
            bench.mcs.tick([])
        assert all(bench.reply(number)["success"] for number in numbers)
        return bench.mcs.measured.tick - began

    assert ticks("left", "right") <= 1.05 * max(ticks("left"), ticks("right"))


@pytest.mark.parametrize("payload_of", ["left", "right"])
def test_a_payload_disturbs_the_rest_of_those_alone_who_carry_it(make_bench, frictionless, payload_of):
    bench = make_bench(frictionless)
    bench.to_motion("left", "right")
    number = bench.send("set_payload", group=payload_of, mass=1.0, center=[0, 0, 0.05], inertia=[0.0] * 6)
    assert bench.reply(number)["success"]
    assert {name for name, group in bench.mcs.groups.items() if not group.monitor.at_rest} == {payload_of}


def test_a_lease_that_lapses_stops_its_own_group_alone(make_bench, frictionless, cell):
    bench = make_bench(frictionless)
    for group, owner, lease_s in (("left", "ann", 0.0), ("right", "bob", 1.0)):
        assert bench.ask("reserve", group=group, owner=owner, lease_s=lease_s)["success"]
        for request in ("power_on", "enable_motion"):
            assert bench.ask(request, sender={"names": [owner]})["success"]
    far, back = cell.home + 0.1, cell.home
    assert bench.ask("renew", owner="bob")["success"]
    bobs = bench.send("move", group="right", path=path(far[RIGHT]), speed_scale=0.1, **BOB)
    anns = bench.ask("move", group="left", path=path(far[LEFT], back[LEFT], far[LEFT]), **ANN)
    assert anns["success"], anns
    assert bench.reply(bobs)["error"]["code"] == "lease"
    for request in ("disable_motion", "power_off"):
        assert bench.ask(request, group="right", **ANN)["success"]  # its owner is given up on
    bench.mcs.tick([])
    assert bench.mcs.manager.reservations.groups == ("left",)
