"""Objects are picked up, handed over and set down by commands of the whole machine; truth is asked afterwards."""

import json

import pytest
from geometry_msgs.msg import Point, Pose

from im_core.config import package_file
from support.whole_machine import running_machine

pytestmark = pytest.mark.end_to_end


@pytest.fixture(scope="module")
def machine():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IM_OBJECTS", str(package_file("im_cell", "cells/puma_pair/objects.yaml")))
        with running_machine() as machine:
            yield machine


def truth(machine):
    from im_msgs.srv import GetTruth

    return json.loads(machine.call(GetTruth, "/testbed/get_truth").json)["objects"]


def test_a_block_is_set_down_where_it_was_asked_for(machine):
    before = truth(machine)
    x, y, z = before["block"][:3]
    picked = machine.execute("pick", position=[x, y, z + 0.055], width=0.05, force=60.0)()
    assert picked.success, picked.status.message
    assert truth(machine)["block"][2] == pytest.approx(z + 0.12, abs=0.01), "lifted"
    placed = machine.execute("place", position=[x + 0.15, y + 0.1, z + 0.057])()
    assert placed.success, placed.status.message
    after = truth(machine)
    assert after["block"][:3] == pytest.approx([x + 0.15, y + 0.1, z], abs=3e-3)
    for other in before.keys() - {"block"}:
        assert after[other][:3] == pytest.approx(before[other][:3], abs=2e-3), "nothing else was touched"


def test_where_nothing_is_and_where_no_arm_reaches_it_is_told(machine):
    nothing = machine.execute("pick", position=[-0.6, 1.0, 0.95])()
    assert not nothing.success
    assert "the jaws closed to 0 mm, and hold nothing" in nothing.status.message
    far = machine.execute("pick", position=[0.0, 5.0, 1.0])()
    assert not far.success
    assert "cannot be at (0, 5, 1.12) m in world" in far.status.message


def set_thing(machine, **fields):
    from im_msgs.srv import SetThing

    return machine.call(SetThing, "/mcs/set_thing", **fields)


def test_what_cannot_be_is_a_sentence_and_moves_nothing(machine):
    for command, arguments, why in (
        ("hand_over", {"giver": "left", "receiver": "left"}, "a hand over needs both arms"),
        ("hand_over", {"position": [0.0, 5.0, 1.0]}, "cannot be at"),
        ("pick", {"position": [-0.45, 0.9, 0.9], "name": "cup"}, "there is no object or link 'cup'"),
    ):
        ended = machine.execute(command, **arguments)()
        assert not ended.success
        assert why in ended.status.message
    for fields, why in (
        ({"name": "cup", "frame": "world"}, "there is no object 'cup'"),
        ({"name": "can", "frame": "left_elbow"}, "there is no frame 'left_elbow'"),
        ({"name": "left_link6", "frame": "world"}, "is a part of the cell"),
        ({"name": "can", "frame": "world", "pose": Pose(position=Point(x=1e3))}, "beyond 100 m"),
        ({"name": "can", "frame": "", "keep": True}, "there is no object 'can'"),
    ):
        answer = set_thing(machine, **fields)
        assert not answer.success
        assert why in answer.message


def test_a_bottle_known_to_mcs_is_handed_from_one_arm_to_the_other(machine):
    for name, (x, y, z, *_) in truth(machine).items():
        answer = set_thing(machine, name=name, frame="world", pose=Pose(position=Point(x=x, y=y, z=z)))
        assert answer.success, answer.message
    x, y, z = truth(machine)["bottle"][:3]
    picked = machine.execute("pick", position=[x, y, z + 0.085], width=0.05, force=60.0, name="bottle")()
    assert picked.success, picked.status.message
    handed = machine.execute("hand_over", name="bottle", width=0.05)()
    assert handed.success, handed.status.message
    held = truth(machine)["bottle"]
    assert held[:3] == pytest.approx([0.0, 0.7, 1.1 - 0.085], abs=1e-2), "the right jaws hold it in the air"
