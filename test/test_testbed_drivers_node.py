"""A robot that speaks topics, driven by MCS through :class:`im_mcs.testbed.joint_state.JointStateDriver`."""

import contextlib
import os
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from im_core import clock
from im_core.errors import LinkError
from im_mcs.testbed.driver import Drive
from im_mcs.testbed.joint_state import CommandTopicDriver, JointStateDriver
from support.vendor_robot import UR5E, UR5E_HOME

INSTANCE = f"imtopics{os.getpid()}"
JOINTS = ["shoulder", "elbow"]
NOTHING = np.zeros(0)
SILENCE_S = 2.0

#: Two masses of 1 kg m2 without friction; holds what has not been commanded for 0.1 s. Its joints have an order of
#: their own.
ROBOT = """
    import sys
    import rclpy
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from im_core import clock
    from im_core.ros import qos, run

    class Robot(Node):
        def __init__(self):
            super().__init__("robot")
            self.q, self.v = {"gripper": 9.0, "elbow": 0.5, "shoulder": -0.5}, {}
            self.effort, self.commanded = {}, {}
            self.last = clock.monotonic()
            self.publisher = self.create_publisher(JointState, "/robot/state", qos.SENSOR)
            self.create_subscription(JointState, "/robot/command", self.obey, qos.SENSOR)
            self.create_timer(0.004, self.step)

        def obey(self, message):
            for name, effort in zip(message.name, message.effort):
                self.effort[name], self.commanded[name] = effort, clock.monotonic()

        def step(self):
            now = clock.monotonic()
            dt, self.last = min(now - self.last, 0.01), now
            for name in self.q:
                if now - self.commanded.get(name, 0.0) > 0.1:
                    self.v[name] = 0.0
                else:
                    self.v[name] = self.v.get(name, 0.0) + self.effort[name] * dt
                    self.q[name] += self.v[name] * dt
            message = JointState(name=list(self.q), position=list(self.q.values()))
            self.publisher.publish(message)

    sys.exit(run.main(Robot))
"""


@contextlib.contextmanager
def robot():
    process = subprocess.Popen([sys.executable, "-c", textwrap.dedent(ROBOT)])
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def drive_to(driver, target):
    """A PD law in every tick until every joint is at its target and at rest; the last reading."""
    last, deadline = driver.read().q, clock.monotonic() + 60.0
    velocity = np.zeros(len(last))
    while clock.monotonic() < deadline:
        measured = driver.read()
        velocity = 0.8 * velocity + 0.2 * (measured.q - last) / driver.period_s
        last = measured.q
        if np.abs(measured.q - target).max() < 0.01 and np.abs(velocity).max() < 0.01:
            return measured
        tau = 30.0 * (target - measured.q) - 9.0 * velocity
        driver.write(Drive(tau, True, np.array([False, False]), NOTHING, True, NOTHING))
        clock.sleep(driver.period_s)
    return driver.read()


def standing(driver):
    """Where the robot stands once it moves no more, shape (n,)."""
    deadline = clock.monotonic() + 60.0
    while clock.monotonic() < deadline:
        before = driver.read().q
        clock.sleep(0.3)
        now = driver.read()
        if now.age_s.max() < 0.1 and (now.q == before).all():  # what it says is not from before
            return before
    pytest.fail("the robot did not come to a stand")


def test_a_robot_that_speaks_topics_moves_and_its_silence_is_a_fault():
    with robot() as process:
        driver = JointStateDriver(
            INSTANCE, 60.0, {}, JOINTS, "/robot/state", "/robot/command", period_s=0.005, silence_s=SILENCE_S
        )
        try:
            measured = driver.read()
            assert measured.q.tolist() == [-0.5, 0.5], "joints are matched by name"
            assert not measured.power
            assert measured.brakes.all()
            target = np.array([0.1, -0.2])
            measured = drive_to(driver, target)
            np.testing.assert_allclose(measured.q, target, atol=0.03)
            assert 0.0 <= measured.age_s.max() < SILENCE_S

            held = Drive(np.full(2, 50.0), True, np.array([True, False]), NOTHING, True, NOTHING)
            off = Drive(np.full(2, 50.0), False, np.array([False, False]), NOTHING, True, NOTHING)
            before = standing(driver)  # the robot's own time-out has stopped it
            for _ in range(30):
                driver.write(off)
                clock.sleep(0.005)
            np.testing.assert_allclose(driver.read().q, before, atol=1e-12)
            deadline = clock.monotonic() + 60.0
            while (after := driver.read().q)[1] <= before[1] + 0.01 and clock.monotonic() < deadline:
                driver.write(held)
                clock.sleep(0.005)
            assert after[1] > before[1] + 0.01
            assert after[0] == before[0], "a braked joint is not commanded"

            process.send_signal(signal.SIGKILL)
            process.wait()
            silent = r"topic '/robot/state' has said nothing of joint 'shoulder' for [0-9.]+ s; 2 s are allowed"
            with pytest.raises(LinkError, match=silent):
                drive_to(driver, -target)
            with pytest.raises(LinkError, match=r"'/robot/state' .* 2 s are allowed"):
                driver.connect()
        finally:
            driver.close()
    assert not [name for name in os.listdir("/dev/shm") if INSTANCE in name]


def test_a_joint_that_the_robot_does_not_have_is_named():
    with robot():
        JointStateDriver(INSTANCE, 60.0, {}, JOINTS, "/robot/state", "/robot/command").close()  # it has begun
        with pytest.raises(LinkError, match=r"nothing of joint wrist within 10 s; it names gripper, elbow, shoulder$"):
            JointStateDriver(INSTANCE, 10.0, {}, ["elbow", "wrist"], "/robot/state", "/robot/command")


def test_a_robot_that_says_nothing_is_told_apart_from_one_that_lacks_a_joint():
    with pytest.raises(LinkError, match=r"nothing of joint elbow within 2 s; nothing was received$"):
        JointStateDriver(INSTANCE, 2.0, {}, ["elbow"], "/nobody/state", "/nobody/command")


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"topic": "/a", "field": "mode"}, "topic '/a': std_msgs/msg/Bool has no field 'mode'"),
        ({"topic": "/a", "type": "no_msgs/msg/Mode"}, "there is no package with msg types 'no_msgs'"),
    ],
)
def test_a_fault_topic_of_an_unknown_kind_is_named(fault, message):
    with pytest.raises(LinkError, match=f"'/nobody/state' ended with code 1: {message}"):
        JointStateDriver(INSTANCE, 60.0, {}, ["elbow"], "/nobody/state", "/nobody/command", faults=[fault])


def test_the_robot_of_the_tutorial_goes_where_it_is_told_and_stands_when_power_goes(process):
    process(sys.executable, "-m", "support.vendor_robot")
    driver = CommandTopicDriver(
        INSTANCE,
        60.0,
        dict.fromkeys(range(6), "position"),
        UR5E[::-1],
        "/joint_states_of_vendor",
        "/forward_position_controller/commands",
        command_joints=UR5E,
        period_s=0.008,
        silence_s=10.0,
    )
    try:
        begin = driver.read().q
        np.testing.assert_allclose(begin, UR5E_HOME[::-1], atol=1e-9)
        free, deadline = np.zeros(6, dtype=bool), clock.monotonic() + 60.0
        while np.abs(driver.read().q - begin - 0.2).max() > 1e-3 and clock.monotonic() < deadline:
            driver.write(Drive(begin + 0.2, True, free, NOTHING, True, NOTHING))
            clock.sleep(0.008)
        np.testing.assert_allclose(driver.read().q, begin + 0.2, atol=2e-3)
        for _ in range(50):  # the servo gives the place of a joint that it does not drive
            driver.write(Drive(driver.read().q, False, free, NOTHING, True, NOTHING))
            clock.sleep(0.008)
        np.testing.assert_allclose(driver.read().q, begin + 0.2, atol=2e-3)
    finally:
        driver.close()
