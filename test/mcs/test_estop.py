"""An emergency stop in every state, with and without a servo that listens; and what a reset waits for."""

import os
import signal
import threading

from action_msgs.msg import GoalStatus

from im_core import names
from im_mcs.safety.stop_mark import StopMark
from im_mcs.state import UNCONFIGURED_MESSAGE
from im_msgs.action import Move
from support.motions import dead

CAUSE = "request on /mcs/estop"
GOALS = 200


def test_unconfigured(client):
    assert client.change("cleanup")
    answer = client.trigger("estop")
    assert answer.success
    assert CAUSE in answer.message
    assert "the stop circuit of testbed is cut" in answer.message
    client.until(lambda: client.state() == "unconfigured" and f"latched ({CAUSE})" in client.states[-1].reason)
    assert not client.change("configure")
    assert client.lifecycle() == "unconfigured"
    assert client.trigger("reset").message == "MCS is unconfigured"
    assert client.trigger("reset").message == UNCONFIGURED_MESSAGE  # nothing is latched any more
    client.until(lambda: not client.states[-1].reason)
    assert client.change("configure")
    client.until(lambda: client.state() == "cold")
    client.to_motion()  # the circuit is whole


def test_it_outlives_the_servo(client, panel):
    """Power is off, but nobody has reset: a servo that is started anew finds that out."""
    assert client.trigger("estop").success
    os.kill(panel.servo_pid, signal.SIGKILL)
    client.until(lambda: client.state() == "unconfigured")
    assert not client.change("configure")
    assert client.trigger("reset").success
    assert client.change("configure")
    client.until(lambda: client.state() == "cold")


def test_a_stop_that_was_asked_for_outlives_who_was_asked(client):
    """Kept in the run folder until it is reset: a node that comes after the death of this one begins stopped."""
    assert client.trigger("estop").success
    client.until(lambda: client.state() == "estopped")
    later = StopMark()
    assert later.read() == CAUSE
    assert client.trigger("reset").success
    assert later.read() == ""
    client.to_motion()


def test_hundreds_of_queued_goals_do_not_hold_an_emergency_stop_up(client, testbed):
    client.to_motion()
    far = client.home.copy()
    far[0] += 1.0
    began = client.start_move(*[far, client.home] * 10, speed_scale=0.01)[1]  # it ends later than all are sent
    queued = client.move_goal(client.home, policy=Move.Goal.APPEND)
    handles = [client.send(Move, "/left/move", queued) for _ in range(GOALS)]
    files = set(evidence())
    answer = client.trigger("estop")
    assert (StopMark().read(), testbed.read_state().power) == (CAUSE, False), "before the answer"
    assert answer.message.startswith("MCS is estopped; the stop circuit of testbed is cut; power is off, ")
    assert "emergency stop" in began().status.message
    client.until(lambda: all(handle.status == GoalStatus.STATUS_ABORTED for handle in handles))
    assert len(set(evidence()) - files) == 1, "of all goals"
    assert client.trigger("reset").success


def test_a_node_whose_loop_stands_still_answers_an_emergency_stop(client, testbed):
    client.to_motion()
    client.start_far_move(speed_scale=0.02)
    going, answered = threading.Event(), threading.Event()

    async def hang():
        going.set()
        assert answered.wait(60.0), "the emergency stop waits for the loop"

    client.mcs.spawn(hang())
    assert going.wait(60.0)
    assert client.trigger("estop").success
    assert (StopMark().read(), testbed.read_state().power) == (CAUSE, False)
    answered.set()
    client.until(lambda: client.state() == "estopped")


def test_state_tells_the_power_of_a_servo_that_hangs_as_it_is(client, panel, testbed):
    client.to_motion()
    client.start_far_move(speed_scale=0.02)
    pid = panel.servo_pid
    os.kill(pid, signal.SIGSTOP)
    try:
        client.until(lambda: dead(testbed))
        since = len(client.states)
        client.until(lambda: len(client.states) > since + 1)
        assert not client.states[-1].power
        assert client.states[-1].brakes
    finally:
        os.kill(pid, signal.SIGCONT)
    client.until(lambda: client.state() == "estopped")


def evidence():
    """Files with the last seconds before an abort."""
    return (names.results_dir() / "mcs").glob("*.npz")
