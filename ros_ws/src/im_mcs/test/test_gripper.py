"""Grippers over the simulated testbed: reach, grip, stop on the way."""

import numpy as np
import pytest

from im_cell.link import JawObject

SPONGE = JawObject(width=0.05, stiffness=1e4, mass=0.1)


@pytest.fixture
def jaws(plant_bench, config):
    """Power on, the left jaws wide open."""
    bench = plant_bench(config, 3)
    for request, given in (("reserve", {"group": "left"}), ("power_on", {})):
        assert bench.ask(request, **given)["success"]
    assert bench.ask("set_gripper", gripper="left_gripper", opening=0.08)["success"]
    return bench


def close(bench, **more):
    return bench.send("set_gripper", gripper="left_gripper", opening=0.0, **more)


def finish(bench, number):
    for _ in range(2000):
        if (reply := bench.reply(number)) is not None:
            return reply
        bench.mcs.tick([])
    raise AssertionError("no answer")


def test_jaws_that_meet_an_object_have_gripped_it(jaws):
    jaws.driver.plant.put((SPONGE, None))
    reply = finish(jaws, close(jaws, force=20.0))
    assert reply["success"]
    assert not reply["results"]["reached"]
    assert reply["results"]["opening"] == pytest.approx(0.05 - 20.0 / 1e4, abs=5e-4)
    assert reply["results"]["force"] == pytest.approx(20.0, abs=2.0)
    empty = finish(jaws, jaws.send("set_gripper", gripper="left_gripper", opening=0.06))
    assert empty["results"]["reached"]
    assert empty["results"]["force"] == pytest.approx(0.0, abs=1.0)


def test_jaws_that_are_cancelled_stop_where_they_are(jaws):
    number = close(jaws)
    for _ in range(15):
        jaws.mcs.tick([])
    cancel = jaws.send("cancel", goal=number)
    assert jaws.reply(cancel)["success"]
    there = float(jaws.mcs.measured.gripper[0])
    assert 0.01 < there < 0.079
    reply = finish(jaws, number)
    assert reply["error"]["code"] == "cancelled"
    assert not jaws.mcs.wants_time
    for _ in range(50):
        jaws.mcs.tick([])
    assert jaws.driver.plant.sensors(0).gripper[0] == pytest.approx(there, abs=2e-3)
    assert "is not under way" in jaws.reply(jaws.send("cancel", goal=number))["error"]["message"]
    assert finish(jaws, close(jaws))["results"]["reached"]


def test_jaws_on_their_way_turn_back_for_who_says_so(jaws):
    first = close(jaws)
    for _ in range(15):
        jaws.mcs.tick([])
    there = float(jaws.mcs.measured.gripper[0])
    assert 0.01 < there < 0.079
    assert "left_gripper is moving" in jaws.reply(close(jaws))["error"]["message"]
    wrong = jaws.send("set_gripper", gripper="left_gripper", opening=0.5, replaces=True)
    assert jaws.reply(wrong)["error"]["code"] == "limit"
    assert jaws.reply(first) is None
    second = jaws.send("set_gripper", gripper="left_gripper", opening=0.08, replaces=True)
    assert finish(jaws, second)["results"]["reached"]
    fault = jaws.reply(first)["error"]
    assert (fault["code"], fault["message"]) == ("replaced", f"left_gripper: replaced by goal {second}")


def test_an_estop_on_the_way_ends_it_by_name(jaws):
    number = close(jaws)
    jaws.mcs.tick([])
    jaws.send("estop", reason="hand")
    assert "hand" in jaws.reply(number)["error"]["message"]
    assert not jaws.mcs.grippers.moving


def read_as(bench, openings):
    """Let the testbed tell ``openings(true openings)``."""
    read = bench.driver.read

    def told():
        measured = read()
        return measured._replace(gripper=openings(measured.gripper))

    bench.driver.read = told


@pytest.mark.parametrize("opening", [0.0, 0.04])
def test_jaws_whose_reading_is_not_steady_come_to_stand(jaws, opening):
    """By a tenth of a millimetre, as of a sensor that is not the simulated testbed's."""
    random = np.random.default_rng(3)
    jaws.driver.plant.put((SPONGE, None))
    read_as(jaws, lambda true: true + random.uniform(-1e-4, 1e-4, 2))
    reply = finish(jaws, jaws.send("set_gripper", gripper="left_gripper", opening=opening, force=20.0))
    assert reply["success"]
    assert not reply["results"]["reached"]
    assert reply["results"]["opening"] == pytest.approx(0.048, abs=5e-4)
    assert finish(jaws, jaws.send("set_gripper", gripper="left_gripper", opening=0.06))["results"]["reached"]


def test_jaws_that_give_no_reading_end_their_motion_by_name(jaws):
    read_as(jaws, lambda true: np.full(2, np.nan))
    assert "left_gripper gave no reading of its opening" in finish(jaws, close(jaws))["error"]["message"]
    number = close(jaws)
    assert jaws.reply(jaws.send("cancel", goal=number))["success"]
    assert finish(jaws, number)["error"]["code"] == "cancelled"
    assert not jaws.mcs.wants_time
