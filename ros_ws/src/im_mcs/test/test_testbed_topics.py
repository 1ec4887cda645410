"""The driver's end of a robot that speaks topics, with the test as its bridge; ``test/`` has one with DDS."""

import os
import threading

import numpy as np
import pytest

from im_core import clock
from im_core.errors import ConfigError, LinkError
from im_core.shm_names import remove_all
from im_mcs.testbed import Drive, joint_state
from im_mcs.testbed.joint_state import CommandTopicDriver, JointStateDriver, TopicLink

INSTANCE = f"imbridge{os.getpid()}"
NAME = f"{INSTANCE}_topics_robot_state"
NOTHING = np.zeros(0)


class Bridge:
    """Stands for the bridge's process, which is not started."""

    def __init__(self):
        self.code = None

    @classmethod
    def of_module(cls, module, arguments):
        return cls()

    def poll(self):
        return self.code

    def stop(self):
        self.code = -15


@pytest.fixture
def bridge(monkeypatch):
    """``bridge(q, age_s, named)`` lets the robot speak; what it says first is awaited by the driver."""
    monkeypatch.setattr(joint_state, "ChildProcess", Bridge)
    links = []

    def say(q, age_s=0.0, named="x, y"):
        if not links:
            links.append(TopicLink.attach(NAME, TopicLink.layout(2), timeout_s=30.0))
        record = links[0].received.record()
        record["q"], record["named"] = q, named.encode()
        record["at"] = np.where(np.isfinite(age_s), clock.monotonic() - np.asarray(age_s), 0.0)
        links[0].received.write(record)
        return links[0]

    yield say
    for link in links:
        link.close()
    assert remove_all(INSTANCE) == []


def make(**settings):
    return JointStateDriver(INSTANCE, 0.5, {}, ["x", "y"], "/robot/state", "/robot/command", **settings)


def test_ages_count_from_receipt_and_nan_stays_with_its_joint(bridge):
    thread = threading.Thread(target=bridge, args=([1.0, 2.0],))
    thread.start()
    driver = make(silence_s=0.3)
    thread.join()
    bridge([3.0, np.nan], [0.05, 0.2])
    measured = driver.read()
    assert measured.q[0] == 3.0
    assert np.isnan(measured.q[1])
    np.testing.assert_allclose(measured.age_s, [0.05, 0.2], atol=0.04)
    bridge([3.0, 4.0], [0.0, 0.35])
    with pytest.raises(
        LinkError, match=r"'/robot/state' has said nothing of joint 'y' for 0.3\d* s; 0.3 s are allowed"
    ):
        driver.read()
    driver.close()


def test_commands_are_of_joints_with_power_and_without_brake(bridge):
    thread = threading.Thread(target=bridge, args=([1.0, 2.0],))
    thread.start()
    driver = make(silence_s=5.0)
    thread.join()
    link = bridge([1.0, 2.0])
    for power, brakes, driven in (
        (True, [False, True], [True, False]),
        (False, [False, False], [False, False]),
        (True, [False, False], [True, True]),
    ):
        driver.write(Drive(np.array([5.0, 6.0]), power, np.array(brakes), NOTHING, True, NOTHING))
        assert link.bell.wait(0.1)
        command = link.command.read()
        assert command["value"].tolist() == [5.0, 6.0]
        assert command["driven"].tolist() == driven
        assert driver.read().power == power
        assert driver.read().brakes.tolist() == [b or not power for b in brakes]
    assert driver.read().tick == 3
    driver._process.code = 3
    bridge([1.0, 2.0], 9.0)
    with pytest.raises(LinkError, match=r"im_mcs.ros.topic_channels of topic '/robot/state' ended with code 3"):
        driver.read()
    assert not link.command.read()["driven"].any()
    driver.close()


def test_what_the_robot_never_names_is_named(bridge):
    thread = threading.Thread(target=bridge, args=([1.0, 0.0], [0.0, np.inf], "x, z"))
    thread.start()
    with pytest.raises(LinkError, match=r"'/robot/state' said nothing of joint y within 0.5 s; it names x, z"):
        make()
    thread.join()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"joints": []}, "needs the names of its joints"),
        ({"joints": ["x", "y", "x"]}, "joint 'x' is named twice"),
        ({"joints": ["x"], "silence_s": 0.0}, r"silence_s of the driver of topic '/a' is 0.0, not > 0 \[s\]"),
    ],
)
def test_wrong_settings_are_one_sentence(settings, message):
    with pytest.raises(ConfigError, match=message):
        JointStateDriver(INSTANCE, 0.1, {}, state_topic="/a", command_topic="/b", **settings)


def test_stamps_are_of_the_computers_clock_and_rise(bridge):
    thread = threading.Thread(target=bridge, args=([1.0, 2.0],))
    thread.start()
    driver = make(silence_s=60.0)
    thread.join()
    began = clock.wall()
    stamps = [driver.read().stamp_ns for _ in range(20)]
    assert began - 1.0 < 1e-9 * stamps[0] <= 1e-9 * stamps[-1] < clock.wall() + 1.0
    assert (np.diff(stamps) > 0).all()
    driver.close()


def test_a_fault_of_the_robot_takes_the_power_away_and_is_told(bridge):
    thread = threading.Thread(target=bridge, args=([1.0, 2.0],))
    thread.start()
    driver = make(silence_s=60.0)
    thread.join()
    driver.write(Drive(np.zeros(2), True, np.zeros(2, dtype=bool), NOTHING, True, NOTHING))
    assert driver.read().power
    assert driver.faults() == []
    link = bridge([1.0, 2.0])
    record = link.received.read().copy()
    record["faults"] = b"/robot/estop data is True"
    link.received.write(record)
    measured = driver.read()
    assert not measured.power
    assert measured.brakes.all()
    assert [fault.what for fault in driver.faults()] == ["/robot/estop data is True"]
    driver.close()


@pytest.mark.parametrize(
    ("interfaces", "settings", "message"),
    [
        ({0: "position", 1: "velocity"}, {}, "slots of the driver of topic '/b' take position and velocity"),
        ({0: "position"}, {}, "the driver of topic '/b' commands all of its joints, and y has no slot"),
        (
            {0: "position", 1: "position"},
            {"command_joints": ["y", "z"]},
            "command_joints of the driver of topic '/b' are y, z; they must be the joints x, y",
        ),
        ({}, {"faults": [{"topc": "/a"}]}, "faults of the driver of topic '/a': topic"),
    ],
)
def test_settings_of_a_controller_that_do_not_fit_are_one_sentence(interfaces, settings, message):
    with pytest.raises(ConfigError, match=message):
        CommandTopicDriver(INSTANCE, 0.1, interfaces, ["x", "y"], "/a", "/b", **settings)
