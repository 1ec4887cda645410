"""What /mcs makes of the states that its servo tells: a loss that is over by itself, or a stop that stays."""

import logging
from pathlib import Path
from types import SimpleNamespace

import pytest

from im_core.errors import StoreError
from im_mcs.ros.servo_keeper import ServoKeeper
from im_mcs.state import Event, State

LOSS, ASKED = "the testbed is gone", "request on /mcs/estop"


@pytest.fixture
def keeper():
    """A keeper whose servo is estopped, and ``tell``: what that servo says."""
    node = SimpleNamespace(get_logger=lambda: logging.getLogger("keeper"), wake=lambda: None)
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


def test_a_stop_that_cannot_be_kept_on_the_disk_cuts_the_stop_circuits(keeper, monkeypatch):
    async def full(*_, **__):
        raise StoreError("no space left on device", file=Path("estop"), reason="no space left on device")

    cut = []
    keeper._circuits = SimpleNamespace(cut=lambda: cut.append(1) or "the stop circuit of testbed is cut")
    monkeypatch.setattr("im_mcs.ros.servo_keeper.run_in_thread", full)
    tell(keeper, ASKED, False)
    with pytest.raises(StopIteration):
        keeper._keep_mark().send(None)
    assert cut == [1]
