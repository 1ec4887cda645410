"""A node, or a servo process, that lives but does nothing any more."""

import os
import signal

import numpy as np
import pytest

from im_cell.link import PanelEnd, ServoEnd
from im_core import clock, names
from im_mcs.client.time_source import FlowingTime
from im_mcs.limits.configuration import load_config
from im_mcs.ros import servo_keeper
from im_msgs.srv import ReserveGroup

SLOW = {"speed_scale": 0.02}


@pytest.fixture(scope="module")
def owner_silence_s():
    return load_config().safety.owner_silence_s


@pytest.fixture
def servo():
    """Process id of the servo."""
    with PanelEnd.attach(names.instance(), 60.0) as panel:
        yield lambda: panel.servo_pid


def test_a_node_whose_loop_stands_still_is_stopped_for_and_goes_on_afterwards(client, owner_silence_s):
    """Its threads live on; only what spins the node hangs."""
    client.to_motion()
    _, result = client.start_far_move(**SLOW)

    async def hang():
        clock.sleep(owner_silence_s + 2.0)

    client.mcs.spawn(hang())
    answer = result()
    assert answer.status.message.startswith("the process that owns the servo gave no heartbeat for ")
    assert f" s, {owner_silence_s:g} s are allowed" in answer.status.message
    client.until(lambda: client.state() == "reserved" and not client.states[-1].power)
    assert "gave no heartbeat" in client.states[-1].reason
    assert client.lifecycle() == "inactive"
    stopped = client.group_state().q
    assert client.trigger("power_on").success
    client.until(lambda: client.state() == "active" and not client.states[-1].reason)
    assert client.trigger("enable_motion").success
    np.testing.assert_allclose(client.group_state().q_rest, stopped, atol=2e-4)
    assert client.move(client.home).success


def test_a_servo_that_hangs_is_named_and_waited_for_by_nobody(client, servo):
    sentence = "the servo process hangs: it has given no heartbeat for 3 s"
    client.to_motion()
    _, result = client.start_far_move(**SLOW)
    pid = servo()
    os.kill(pid, signal.SIGSTOP)
    try:
        assert sentence in result().status.message
        client.until(lambda: client.states[-1].reason == sentence)
        answer = client.call(ReserveGroup, "reserve", group="right")
        assert (answer.success, answer.message) == (False, sentence)
        assert sentence in client.trigger("estop").message  # passed on nevertheless
        with PanelEnd.attach(names.instance(), 60.0) as panel, ServoEnd.attach(names.instance(), 60.0) as end:
            panel.request_time(2)
            client.until(lambda: end.read_state().brakes.all() and not end.read_state().power)
    finally:
        os.kill(pid, signal.SIGCONT)
    client.until(lambda: client.state() == "estopped" and sentence not in client.states[-1].reason)
    assert client.states[-1].reason
    client.until(lambda: servo() == pid)
    assert client.trigger("reset").success
    client.to_motion()
    assert client.move(client.home).success


def test_a_servo_that_lives_and_hears_nothing_is_named_and_waited_for_by_nobody(client, monkeypatch):
    """Here no tick comes in which it would hear, for nobody asks for the time of one."""
    sentence = "the servo process hangs: it gives heartbeats, and has heard no request for 1 s"
    monkeypatch.setattr(servo_keeper, "_UNHEARD_S", 1.0)
    servo = client.mcs._mcs.client()
    with monkeypatch.context() as deaf:
        deaf.setattr(servo, "_time", FlowingTime())
        for _ in range(2):
            answer = client.call(ReserveGroup, "reserve", group="left")
            assert (answer.success, answer.message) == (False, sentence)
    servo._time.ask()
    client.until(lambda: not client.states[-1].reason)
    client.to_motion()
    assert client.move(client.home).success
