"""The bench of MCS watches parts of a tick by their names: they must be there."""

from collections import defaultdict

from bench.mcs.rig import START, WAY, rig
from bench.mcs.tick import _watch_parts
from im_mcs.limits.configuration import load_config


def test_each_part_of_a_tick_is_met_in_motion():
    present = defaultdict(float)
    spent = {}

    def keep():
        for part, seconds in present.items():
            spent[part] = spent.get(part, 0.0) + seconds
            present[part] = 0.0

    with rig(load_config(None).with_preset("1x18"), seed=1) as machine:
        machine.to_motion("testbed")
        _watch_parts(machine, present)
        machine.move("testbed", START + 0.01 * WAY, on_tick=keep)
    assert min(spent.values()) > 0.0
    assert {"tick", "slots read", "watches", "planning", "control law", "record", "slots written"} <= spent.keys()
