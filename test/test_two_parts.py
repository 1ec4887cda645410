"""Two commands at once over one table: two parts, one part asked for twice, a part taken away under the jaws."""

import json

import pytest
from geometry_msgs.msg import Point, Pose, Quaternion

from im_core.config import package_file
from im_msgs.srv import GetTruth, PlaceObject
from support.whole_machine import COMMAND_S, running_machine

pytestmark = pytest.mark.end_to_end

LONG_S = 5.0 * COMMAND_S
BLOCK, CAN = "block", "can"
BLOCK_AT, CAN_AT = (-0.45, 0.90, 0.83), (0.25, 0.90, 0.82)


@pytest.fixture(scope="module")
def running():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IM_OBJECTS", str(package_file("im_cell", "cells/puma_pair/objects.yaml")))
        with running_machine() as machine:
            yield machine


@pytest.fixture
def machine(running):
    """Both arms at home with open jaws, and both parts in their places."""
    for group in ("left", "right"):
        require(running.execute("open_gripper", group=group)(LONG_S))
        require(running.execute("home", group=group)(LONG_S))
    put(running, BLOCK, BLOCK_AT)
    put(running, CAN, CAN_AT)
    return running


def require(ended):
    assert ended.success, ended.status.message


def put(machine, name, place):
    pose = Pose(position=Point(**dict(zip("xyz", place, strict=True))), orientation=Quaternion(w=1.0))
    placed = machine.call(PlaceObject, "/testbed/place_object", name=name, pose=pose)
    assert placed.success, placed.message


def place_of(machine, name):
    return json.loads(machine.call(GetTruth, "/testbed/get_truth").json)["objects"][name][:3]


def both(*begun):
    return [ended(LONG_S) for ended in begun]


def pick(machine, group, place, width):
    x, y, z = place
    return machine.execute("pick", group=group, position=[x, y, z + 0.055], width=width, force=60.0)


def test_two_parts_are_moved_at_once_also_close_to_each_other(machine):
    for ended in both(pick(machine, "left", BLOCK_AT, 0.05), pick(machine, "right", CAN_AT, 0.06)):
        require(ended)
    to = {"left": (-0.12, 0.95), "right": (0.13, 0.95)}  # where the carts come into each other's way
    down = [
        machine.execute("place", group=group, position=[*to[group], z + 0.057])
        for group, (_, _, z) in (("left", BLOCK_AT), ("right", CAN_AT))
    ]
    for ended in both(*down):
        require(ended)
    assert place_of(machine, BLOCK) == pytest.approx([*to["left"], BLOCK_AT[2]], abs=5e-3)
    assert place_of(machine, CAN) == pytest.approx([*to["right"], CAN_AT[2]], abs=5e-3)


def test_two_arms_are_asked_for_one_thing(machine):
    ended = both(pick(machine, "left", BLOCK_AT, 0.05), pick(machine, "right", BLOCK_AT, 0.05))
    told = [each.status.message for each in ended if not each.success]
    assert len(told) == 1, "one arm has it"
    assert "would collide with" in told[0] or "come too close" in told[0] or "hold nothing" in told[0]
    assert place_of(machine, BLOCK)[2] == pytest.approx(BLOCK_AT[2] + 0.12, abs=0.01), "and holds it"
    require(machine.execute("home", group="right" if ended[0].success else "left")(LONG_S))


def test_a_part_is_taken_away_before_the_jaws_close(machine):
    begun = pick(machine, "left", BLOCK_AT, 0.05)
    machine.wait_for_firing("pick", "grasp.allow.pass")
    put(machine, BLOCK, (-0.45, 1.3, 0.83))
    ended = begun(LONG_S)
    assert not ended.success
    assert "the jaws closed to 0 mm, and hold nothing" in ended.status.message
    require(machine.execute("home", group="left")(LONG_S))
