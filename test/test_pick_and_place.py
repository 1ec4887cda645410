"""A block is picked up and set down by commands of the whole machine; truth is asked afterwards."""

import json

import pytest

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
