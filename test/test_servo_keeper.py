"""What /mcs makes of the states that its servo tells: a loss that is over by itself, or a stop that stays."""

import logging
from types import SimpleNamespace

import pytest

from im_mcs.ros.servo_keeper import ServoKeeper
from im_mcs.state import State

LOSS, ASKED = "the testbed is gone", "request on /mcs/estop"


@pytest.fixture
def keeper():
    """A keeper whose servo is estopped, and ``tell``: what that servo says."""
    node = SimpleNamespace(get_logger=lambda: logging.getLogger("keeper"), wake=lambda: None)
    keeper = ServoKeeper(node, SimpleNamespace(state="inactive"), None, 1.0, SimpleNamespace(), lambda: None)
    keeper._owner = SimpleNamespace(client=SimpleNamespace(state=lambda: State.ESTOPPED))
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
