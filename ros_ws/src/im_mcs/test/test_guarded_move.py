"""Guarded moves: a motion ends where a wrist meets something, and fails where it meets nothing."""

from types import SimpleNamespace

import numpy as np
import pytest

from im_cell.rotations import matrix_of_vector, quaternion_of_matrix
from im_mcs.state import State

WEIGHT, STIFFNESS = np.array([0.0, 0.0, -12.0]), 2000.0  # of the load [N]; of the floor [N/m]
BY_LEFT = slice(0, 9)


@pytest.fixture
def world(bench, cell, model):
    """Arms with a load each, above a floor that gives way."""
    wrists = list(cell.devices("force").values())
    heights = [float(model.pose(cell.home, wrist).translation[2]) for wrist in wrists]
    world = SimpleNamespace(floor=heights[wrists.index("left_wrist")] - 0.03, silent=False)
    read = bench.driver.read

    def feel():
        measured = read()
        for row, wrist in enumerate(wrists):
            pose = model.pose(measured.q, wrist)
            pressed = STIFFNESS * max(0.0, world.floor - pose.translation[2]) * (wrist == "left_wrist")
            measured.wrench[row, :3] = pose.rotation.T @ (WEIGHT + pressed * np.array([0.0, 0.0, 1.0]))
        if world.silent:
            measured.wrench[:] = np.nan
        return measured

    bench.driver.read = feel
    bench.to_motion("left")
    return world


def down(model, cell, depth, turned=0.0):
    """A line of the left wrist, straight down [m], that turns about the vertical [rad]."""
    pose = model.pose(cell.home, "left_wrist")
    orientation = quaternion_of_matrix(matrix_of_vector([0.0, 0.0, turned]) @ pose.rotation)
    return {"kind": "line", "poses": [[*(pose.translation - [0.0, 0.0, depth]).tolist(), *orientation]], "speed": 0.05}


@pytest.mark.parametrize("turned", [0.0, 0.5])
def test_it_ends_at_the_contact_whatever_the_load_weighs_on_the_way(world, bench, model, cell, turned):
    reply = bench.ask("move", group="left", path=down(model, cell, 0.06, turned), until_force=8.0)
    assert reply["success"], reply["error"]
    assert 8.0 <= reply["results"]["force"] < 10.0
    pressed = world.floor - model.pose(bench.driver.q, "left_wrist").translation[2]
    assert 8.0 / STIFFNESS <= pressed < 8.0 / STIFFNESS + 0.006  # and stands, 5 mm behind it at this speed
    assert bench.mcs.groups["left"].monitor.at_rest
    assert bench.mcs.manager.state is State.MOTION
    assert bench.move("left", cell.home[BY_LEFT])["success"]


def test_the_end_of_the_path_without_contact_is_a_failure(world, bench, model, cell):
    world.floor = -1.0
    reply = bench.ask("move", group="left", path=down(model, cell, 0.04), until_force=8.0)
    assert not reply["success"]
    assert reply["error"]["code"] == "no_contact"
    assert "no contact on the way" in reply["error"]["message"]
    assert "8 N were asked for" in reply["error"]["message"]


def test_what_waits_behind_does_not_begin_after_a_contact(world, bench, model, cell):
    first = bench.send("move", group="left", path=down(model, cell, 0.06), until_force=8.0)
    second = bench.ask("move", group="left", path=down(model, cell, 0.0), policy="append")
    assert bench.reply(first)["success"]
    assert second["error"]["code"] == "contact"


def test_a_move_without_a_bound_goes_on_and_a_cancelled_one_is_cancelled(world, bench, model, cell):
    assert bench.ask("move", group="left", path=down(model, cell, 0.04))["success"]
    number = bench.send("move", group="left", path=down(model, cell, 0.0), until_force=100.0)
    for _ in range(40):
        bench.mcs.tick([])
    assert bench.ask("cancel", goal=number)["success"]
    assert bench.reply(number)["error"]["code"] == "cancelled"


def test_a_sensor_without_a_reading_ends_it_by_name(world, bench, model, cell):
    world.silent = True
    reply = bench.ask("move", group="left", path=down(model, cell, 0.04), until_force=8.0)
    assert "the force sensor of left_wrist gives no reading" in reply["error"]["message"]


@pytest.mark.parametrize("force", [-1.0, float("nan"), float("inf"), 1e9, "8"])
def test_an_impossible_force_is_refused(world, bench, model, cell, force):
    reply = bench.ask("move", group="left", path=down(model, cell, 0.04), until_force=force)
    assert not reply["success"]
    assert "until_force" in reply["error"]["message"]
    np.testing.assert_allclose(bench.driver.q, cell.home, atol=1e-6)


def test_a_group_without_a_sensor_refuses_it(bench, cell):
    assert bench.ask("repartition", preset="3x6")["success"]
    bench.to_motion("transporter")
    index = bench.mcs.groups["transporter"].index
    reply = bench.ask(
        "move",
        group="transporter",
        path={"kind": "joint", "points": [(cell.home[index] + 0.01).tolist()], "blend": 0.0},
        until_force=8.0,
    )
    assert "group 'transporter' has no force sensor" in reply["error"]["message"]
