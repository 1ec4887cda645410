"""Whatever stops an arm is carried out before ten thousand messages that wait in the loop of ``/mcs``."""

import pytest
from action_msgs.srv import CancelGoal
from std_srvs.srv import Trigger

from im_msgs.srv import GroupCommand
from support.flood import Flood

STOPS = {
    "pause": (GroupCommand, "/mcs/pause"),
    "protective_stop": (Trigger, "/mcs/protective_stop"),
    "disable_motion": (GroupCommand, "/mcs/group/disable_motion"),
    "power_off": (GroupCommand, "/mcs/group/power_off"),
    "estop": (Trigger, "/mcs/estop"),
    "cancel": (CancelGoal, "/left/move/_action/cancel_goal"),
}


@pytest.fixture
def flood(client):
    flood = Flood(client.mcs, client.node)
    yield flood
    flood.end()


@pytest.mark.parametrize("stop", STOPS)
def test_an_arm_rests_before_the_work_is_done_that_waits(client, flood, wait_until, stop):
    client.to_motion()
    client.start_far_move(speed_scale=0.02)
    asker, servo, answers = client.node.create_client(*STOPS[stop]), client.mcs._mcs.client(), []
    assert asker.wait_for_service(60.0)
    flood.fill(wait_until)

    def stopped():
        if answers and answers[0].done():
            answer = answers[0].result()
            assert getattr(answer, "success", True), answer.message
            assert not getattr(answer, "return_code", 0), "the cancellation was refused"
        now = servo.snapshot()
        # time stands when all has been answered, maybe before the arm has rested long enough to count as at rest
        return now["at_rest"].all() or now["brakes"].all() or not now["power"]

    assert not stopped(), "it moves on while the loop is held"
    answers.append(asker.call_async(asker.srv_type.Request()))
    flood.let_go(wait_until, stopped)
