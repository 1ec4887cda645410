"""What /mcs makes of the states that its servo tells: a loss that is over by itself, or a stop that stays."""

import logging
import re
from types import SimpleNamespace

import pytest

from im_core.errors import StateError
from im_mcs.ros.servo_keeper import ServoKeeper
from im_mcs.state import Event, State

LOSS, ASKED = "the testbed is gone", "request on /mcs/estop"


@pytest.fixture
def keeper():
    """A keeper whose servo is estopped, and ``tell``: what that servo says."""
    node = SimpleNamespace(
        get_logger=lambda: logging.getLogger("keeper"), wake=lambda: None, spawn=lambda work: work.close()
    )
    keeper = ServoKeeper(node, SimpleNamespace(state="inactive"), None, 1.0, SimpleNamespace(), lambda: None)
    servo = SimpleNamespace(state=State.ESTOPPED, told=[])
    client = SimpleNamespace(
        state=lambda: servo.state,
        send=lambda event, arguments: servo.told.append((event, arguments)),
        beat=lambda: None,
        silence_s=lambda: 0.0,
        unheard_s=lambda: 0.0,
    )
    keeper._owner = SimpleNamespace(client=client, process=SimpleNamespace(check=lambda: None))
    keeper.servo = servo
    return keeper


def tell(keeper, reason, lost, **groups):
    keeper._take_state(State.ESTOPPED, groups, reason, lost)
    keeper.follow()


def test_a_loss_stays_a_loss_however_often_the_states_of_groups_are_told(keeper):
    tell(keeper, LOSS, True, left="motion", right="active")
    assert keeper.lost
    tell(keeper, LOSS, True, left="reserved")
    tell(keeper, LOSS, True)
    assert keeper.lost


def test_an_emergency_stop_that_somebody_asked_for_is_no_loss_whatever_comes_after_it(keeper):
    tell(keeper, ASKED, False, left="motion")
    tell(keeper, ASKED, True, left="reserved")
    assert not keeper.lost


def test_a_stop_that_is_asked_for_after_a_loss_stays(keeper):
    tell(keeper, LOSS, True, left="motion")
    tell(keeper, ASKED, False)
    assert not keeper.lost


def test_a_servo_that_has_not_heard_of_a_stop_is_told_until_it_has(keeper):
    """It hung, or its testbed was away, when somebody asked for it."""
    tell(keeper, ASKED, False)
    keeper.poll()
    assert keeper.servo.told == []
    keeper.servo.state = State.COLD
    keeper.poll()
    assert keeper.servo.told == [(Event.ESTOP, {"reason": ASKED})]
    keeper.servo.state = State.ESTOPPED
    keeper.poll()
    assert len(keeper.servo.told) == 1


def test_what_is_refused_after_the_death_of_the_node_names_that_death(keeper, monkeypatch):
    monkeypatch.setattr("im_mcs.ros.servo_keeper.dead_owner", lambda _: 77)
    again = ServoKeeper(keeper._node, keeper._lifecycle, None, 1.0, SimpleNamespace(), lambda: None)
    death = "/mcs has died (process 77) and was started again"
    assert again.reason == death
    with pytest.raises(StateError, match="^" + re.escape(f"{death}; it is not configured yet, ask again")):
        again.client()
    refusal = StateError("move is refused in state cold", state="cold")
    assert again.explain(refusal).message == f"{refusal.message}; the cause of this state: {death}"
    again._owner = keeper._owner
    again._take_state(State.ACTIVE, {"left": "active"}, "", False)
    again.follow()
    assert again.explain(refusal) is refusal, "work has begun anew"
