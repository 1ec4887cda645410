"""Grippers: by service, and by the action that other tools speak; empty, around an object, and cancelled."""

import math

import pytest
from control_msgs.action import GripperCommand

from im_core import clock
from im_core.ros.calls import call_blocking
from im_msgs.srv import PutInJaws, SetGripper

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


@pytest.fixture
def hand(client):
    """A user of the left gripper, which is wide open."""
    client.to_motion()
    assert client.call(SetGripper, "set_gripper", gripper="left_gripper", close=False).success
    return client


def start(client, position, effort=0.0):
    goal = GripperCommand.Goal()
    goal.command.position, goal.command.max_effort = position, effort
    return client.act(GripperCommand, "/left_gripper/gripper_cmd", goal)


def grip(client, position, effort=0.0):
    return start(client, position, effort)[1]()


@pytest.fixture
def put(hand):
    """``put(width)``: something soft between the jaws, which is taken away in the end."""
    service = hand.node.create_client(PutInJaws, "/testbed/put_in_jaws")

    def call(width):
        request = PutInJaws.Request(gripper="left_gripper", width=width, stiffness=1e4, mass=0.1)
        answer = call_blocking(service, request, 60.0, "object")
        assert answer.success, answer.message

    yield call
    call(0.0)


def test_the_service(hand):
    answer = hand.call(SetGripper, "set_gripper", gripper="left_gripper", close=True)
    assert answer.opening == pytest.approx(0, abs=1e-3)
    answer = hand.call(SetGripper, "set_gripper", gripper="left_gripper", close=False)
    assert answer.opening == pytest.approx(0.08, abs=1e-3)
    answer = hand.call(SetGripper, "set_gripper", gripper="gripper", close=True)
    assert "there is no gripper 'gripper'" in answer.message
    answer = hand.call(SetGripper, "set_gripper", gripper="left_gripper", close=True, force=math.nan)
    assert answer.message == "force is nan, not a finite number"


def test_the_action(hand):
    for position in (0.03, 0.08):
        answer = grip(hand, position, 5.0)
        assert answer.status == SUCCEEDED
        assert answer.result.reached_goal
        assert not answer.result.stalled
        assert answer.result.position == pytest.approx(position, abs=1e-3)
    for wrong in ((math.nan, 0.0), (0.5, 0.0), (-0.01, 0.0), (0.02, -1.0), (0.02, math.inf)):
        assert grip(hand, *wrong).status == ABORTED


def test_jaws_that_an_object_holds_up_have_gripped_it(hand, put):
    put(0.05)
    answer = grip(hand, 0.0, 20.0)
    assert answer.status == SUCCEEDED
    assert (answer.result.stalled, answer.result.reached_goal) == (True, False)
    assert answer.result.position == pytest.approx(0.048, abs=1e-3)
    assert answer.result.effort == pytest.approx(20.0, abs=2.0)


def test_jaws_of_a_cancelled_goal_stop_where_they_are(hand):
    """The testbed is fast; some cancellations come when the jaws are there already, or have not begun to move."""
    for attempt in range(60):
        handle, result = start(hand, 0.0)
        clock.sleep(0.002 * (attempt % 20))
        hand.cancel(handle)
        answer = result()
        assert answer.status in (SUCCEEDED, CANCELED)
        assert answer.result.reached_goal == (answer.status == SUCCEEDED)
        if answer.status == CANCELED and 0.001 < answer.result.position < 0.079:
            break
        assert grip(hand, 0.08).result.reached_goal
    assert answer.status == CANCELED
    assert 0.001 < answer.result.position < 0.079
    assert grip(hand, 0.08).result.reached_goal


def test_a_new_goal_takes_the_place_of_the_one_under_way(hand):
    """Who sends goals while a slider is moved gets the last of them; jaws that are fast may have ended the first."""
    for _ in range(60):
        first = start(hand, 0.0)[1]
        assert grip(hand, 0.08).result.reached_goal
        answer = first()
        if answer.status == ABORTED:
            break
        assert answer.status == SUCCEEDED
    assert answer.status == ABORTED
    assert not answer.result.reached_goal
