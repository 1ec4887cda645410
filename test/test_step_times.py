"""What the dispatcher counts of the firings that anybody may tell of."""

import json

import pytest

from im_dispatcher.report import StepTimes
from im_dispatcher.ros.node import note_firing
from im_msgs.msg import Firing
from im_pnt.netfile import parse_net

LOOP = """
net: loop
places: {idle: 1, asked: , lost: }
transitions:
  begin: {in: idle, out: asked, symbol: loop}
  ask: {in: asked, out: idle, request: arm.move, emit: loop_done, on_failure: lost}
  give_up: {in: lost, out: idle, emit: loop_failed}
"""
ARM = """
net: arm
places: {wanted: , there: , stuck: }
services: {move: {entry: wanted, done: there, failed: stuck}}
transitions: {move: {in: wanted, out: there, action: move, on_failure: stuck}}
"""


@pytest.fixture
def timed():
    """What tells of a firing, and the times that come of it."""
    nets = []
    times = StepTimes(lambda: nets)
    note_firing([times], Firing(net="loop", transition="ask", phase=Firing.END, duration=9.0))  # nobody asks for it yet
    nets += [parse_net(LOOP), parse_net(ARM)]
    return (lambda **said: note_firing([times], Firing(**said))), times


def test_the_steps_of_a_command_are_those_of_its_net_and_of_the_nets_that_this_needs(timed):
    tell, times = timed
    for net, transition in (("loop", "ask"), ("arm", "move"), ("arm", "no_such"), ("other", "move")):
        tell(net=net, transition=transition, phase=Firing.START)
        tell(net=net, transition=transition, phase=Firing.END, duration=0.5)
    assert times.to_dict() == {"loop.ask": [1, 0.5, 0.0], "arm.move": [1, 0.5, 0.0]}


def test_names_that_somebody_makes_up_take_no_memory(timed):
    tell, times = timed
    for number in range(1000):
        for phase in (Firing.START, Firing.END):
            tell(net="zz", transition=f"t{number}", phase=phase)
    assert times == StepTimes(times.nets)


@pytest.mark.parametrize("duration", [float("nan"), float("inf"), -1.0])
def test_a_duration_that_is_none_is_not_counted(timed, duration):
    tell, times = timed
    tell(net="arm", transition="move", phase=Firing.END, duration=duration)
    tell(net="arm", transition="move", phase=Firing.END, duration=0.25)
    assert json.loads(json.dumps(times.to_dict(), allow_nan=False)) == {"arm.move": [1, 0.25, 0.0]}
