"""A turn of the nets that something broke is taken again, and what is told after a turn holds up none."""

import pytest

from im_core import clock
from im_core.ros.node import ManagedNode
from im_pnt_node.ros.execution import loop as net_loop
from im_pnt_node.ros.execution.loop import NetLoop

FAULT = "what nobody thought of"


class Delayed:
    """A net with one delay, after which it is done."""

    due = False

    def __init__(self) -> None:
        self.at, self.pumps, self.fault = clock.monotonic() + 0.2, 0, None

    def pump(self):
        self.pumps += 1
        if self.fault is not None:
            raise self.fault
        if self.at is not None and clock.monotonic() >= self.at:
            self.at = None

    def next_wakeup(self):
        return self.at


@pytest.mark.raises
@pytest.mark.parametrize("broken", ["pump", "commit", "told"])
def test_what_breaks_a_turn_does_not_end_the_next_ones(ros, monkeypatch, wait_until, broken):
    monkeypatch.setattr(net_loop, "RETRY_AFTER_S", 0.1)
    net, faults = Delayed(), {"commit": 0, "told": 0}
    faults[broken] = 1

    def fails(part):
        def call():
            if faults[part]:
                raise ValueError(FAULT)

        return call

    node = ManagedNode("looping")
    loop = NetLoop(node, {"net": net}, lambda: True, fails("commit"), fails("told"))
    if broken == "pump":
        net.fault = ValueError(FAULT)
    ros(node)
    loop.wake()
    wait_until(lambda: node.failures.counts, "the fault")
    net.fault = None
    faults[broken] = 0
    wait_until(lambda: net.at is None, "the end of the delay")
    assert FAULT in node.failures.last
