"""Testbeds that break in the middle of a motion: what MCS says, what it keeps, and that it goes on afterwards."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from im_core.ros.calls import call_blocking
from im_msgs.srv import InjectFault, ReserveGroup

SLOW = {"speed_scale": 0.1}


@pytest.fixture
def inject(client):
    """``inject(fault, joint, active)``; everything is mended in the end."""
    service = client.node.create_client(InjectFault, "/testbed/inject_fault")
    broken = []

    def call(fault, joint="", active=True, duration=0.0):
        request = InjectFault.Request(fault=fault, joint=joint, active=active, duration=duration)
        answer = call_blocking(service, request, 60.0, "fault")
        assert answer.success, answer.message
        broken.append((fault, joint))

    yield call
    for fault, joint in broken:
        if fault != "stall":
            call_blocking(service, InjectFault.Request(fault=fault, joint=joint, active=False), 60.0, "fault")


def check_evidence(message, joint=""):
    """The file that a message names holds the seconds before the fault, and names the joint."""
    path = re.search(r"the last seconds are in (\S+)", message)
    assert path, message
    record = np.load(path[1])
    assert len(record["tick"]) > 20
    assert np.abs(record["setpoint_v"][-100:]).max() > 0.0
    assert json.loads(str(record["fault"]))["message"] in message
    assert joint in Path(path[1]).with_suffix(".csv").read_text().splitlines()[0]


def check_recovery(client):
    """After a reset it moves again, and has not leapt."""
    client.until(lambda: client.state() == "estopped")
    assert client.lifecycle() == "inactive"
    assert client.trigger("reset").success
    for answer in (client.call(ReserveGroup, "reserve", group="left"), client.trigger("power_on")):
        assert answer.success, answer.message
    before = client.group_state().q
    assert client.trigger("enable_motion").success
    np.testing.assert_allclose(client.group_state().q_rest, before, atol=2e-4)
    result = client.move(client.home)
    assert result.success, result.status.message


@pytest.mark.parametrize(
    ("fault", "joint", "sentence"),
    [
        ("encoder_nan", "left_j2", "left_j2 gave no reading at tick"),
        ("encoder_frozen", "left_j3", "the reading of left_j3 is 0.15"),
        ("power_loss", "", "the testbed cut the power at tick"),
    ],
)
def test_a_fault_on_the_way_is_an_estop_with_evidence(client, inject, fault, joint, sentence):
    client.to_motion()
    _, result = client.start_far_move(**SLOW)
    inject(fault, joint)
    message = result().status.message
    assert sentence in message
    check_evidence(message, joint)
    client.until(lambda: client.state() == "estopped" and not client.states[-1].power and client.states[-1].brakes)
    assert sentence in client.states[-1].reason
    inject(fault, joint, active=False)
    check_recovery(client)


def test_a_joint_without_a_reading_cannot_be_reserved(client, inject):
    inject("encoder_nan", "left_track")
    answer = client.call(ReserveGroup, "reserve", group="right")
    assert answer.success, answer.message
    answer = client.call(ReserveGroup, "reserve", group="left")
    assert "group 'left' cannot be reserved: a slot of it gives no reading" in answer.message


def test_power_that_does_not_come_is_said_and_changes_nothing(client, inject):
    assert client.call(ReserveGroup, "reserve", group="left").success
    inject("power_loss")
    answer = client.trigger("power_on")
    assert not answer.success
    client.until(lambda: client.state() == "reserved")
    assert client.lifecycle() == "inactive"
    inject("power_loss", active=False)
    assert client.trigger("power_on").success


def test_a_brake_that_sticks(client, inject):
    assert client.call(ReserveGroup, "reserve", group="left").success
    assert client.trigger("power_on").success
    inject("brake_stuck", "left_j1")
    answer = client.trigger("enable_motion")
    assert not answer.success
    assert "the brakes to release, those of left_j1" in answer.message
    client.until(lambda: client.state() == "active" and client.states[-1].brakes)
    inject("brake_stuck", "left_j1", active=False)
    assert client.trigger("enable_motion").success
    assert client.move(client.home).success


def test_a_brake_that_opens_by_itself(client, inject):
    assert client.call(ReserveGroup, "reserve", group="left").success
    assert client.trigger("power_on").success
    inject("brake_open", "right_j2")
    client.until(lambda: client.trigger("enable_motion") and client.state() == "estopped")
    assert "the brake of right_j2 is open at tick" in client.states[-1].reason
    assert "the brake open of right_j2" in client.trigger("reset").message
    inject("brake_open", "right_j2", active=False)
    client.until(lambda: client.trigger("reset").success)
    client.to_motion()
    assert client.move(client.home).success


def test_a_testbed_that_stalls_is_waited_for_two_seconds(client, inject):
    client.to_motion()
    _, result = client.start_far_move(**SLOW)
    inject("stall", duration=2.8)
    message = result().status.message
    assert "the testbed has not ticked for 2" in message
    check_evidence(message)
    client.until(lambda: client.trigger("reset").success)
    client.to_motion()
    assert client.move(client.home).success


def test_nobody_waits_for_a_testbed_that_stalls_before_it_is_asked(client, inject):
    inject("stall", duration=2.8)
    answer = client.call(ReserveGroup, "reserve", group="left")
    assert not answer.success
    assert "the testbed does not answer: the testbed has not ticked for 2" in answer.message
    client.until(lambda: client.call(ReserveGroup, "reserve", group="left").success)
