"""Node ``/mcs`` with the simulated testbed, as ROS users meet it."""

import math
import os
import signal
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import Pose
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_core import clock, names
from im_core.robot import load_cell
from im_core.ros import qos
from im_core.ros.calls import call_blocking
from im_core.ros.run import spin_in_thread
from im_core.testbed_link import TestbedLink
from im_mcs.ros.node import McsNode
from im_msgs.action import Move
from im_msgs.msg import McsState
from im_msgs.srv import CheckPath, GetGroupState, InverseKinematics, ReserveGroup, SetGripper
from im_sim.ros.node import TestbedNode

UNCONFIGURED = "MCS is unconfigured; configure it first (ros2 lifecycle set /mcs configure)"
HOME = load_cell().home[:9]
TARGET = HOME + np.array([0.05, 0.2, 0.1, 0.2, -0.2, 0.2, 0.3, 0.3, 0.3])


class Client:
    """What a user does to ``/mcs``."""

    def __init__(self, node):
        self.node = node
        self.states, self.joints, self.frames, self.description = [], [], [], []
        node.create_subscription(McsState, "/mcs/state", self.states.append, qos.LATCHED)
        node.create_subscription(JointState, "/joint_states", self.joints.append, qos.EVENTS)
        node.create_subscription(TFMessage, "/tf", self.frames.append, qos.EVENTS)
        node.create_subscription(TFMessage, "/tf_static", self.frames.append, qos.LATCHED)
        node.create_subscription(String, "/robot_description", self.description.append, qos.LATCHED)
        self._clients = {}
        self._move = ActionClient(node, Move, "/left/move")

    def call(self, service_type, name, **fields):
        client = self._clients.get(name) or self.node.create_client(service_type, name)
        self._clients[name] = client
        return call_blocking(client, service_type.Request(**fields), 15.0, name)

    def trigger(self, name):
        return self.call(Trigger, f"/mcs/{name}")

    def lifecycle(self):
        return self.call(GetState, "/mcs/get_state").current_state.label

    def change(self, label):
        return self.call(ChangeState, "/mcs/change_state", transition=Transition(label=label)).success

    def state(self):
        return self.states[-1].state

    def group_state(self):
        answer = self.call(GetGroupState, "/mcs/get_group_state", group="left")
        assert answer.success, answer.status.message
        return answer.state

    def start_move(self, *points, names_=(), feedback=None):
        """Send a goal; a function that waits for its result."""
        assert self._move.wait_for_server(10.0)
        goal = Move.Goal()
        goal.path.joint_names = list(names_)
        goal.path.points = [JointTrajectoryPoint(positions=[float(x) for x in point]) for point in points]
        handle = _wait(self._move.send_goal_async(goal, feedback_callback=feedback))
        result = handle.get_result_async()
        return handle, lambda: _wait(result).result

    def move(self, *points, **options):
        return self.start_move(*points, **options)[1]()

    def to_motion(self):
        for answer in (
            self.call(ReserveGroup, "/mcs/reserve", group="left"),
            self.trigger("power_on"),
            self.trigger("enable_motion"),
        ):
            assert answer.success, answer.message

    def to_cold(self):
        if self.lifecycle() == "unconfigured":
            assert self.change("configure")
        if self.state() != "cold":
            self.trigger("estop")
            assert self.trigger("reset").success


def _wait(future, seconds=20.0):
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    assert done.wait(seconds), "no answer"
    return future.result()


def until(condition, seconds=10.0):
    deadline = clock.monotonic() + seconds
    while not condition():
        assert clock.monotonic() < deadline, "waited in vain"
        clock.sleep(0.01)


@pytest.fixture(scope="module")
def machine():
    """Testbed at clock factor 0, MCS, and a client."""
    rclpy.init(args=["--ros-args", "-p", "standalone:=true", "-p", "testbed:factor:=0.0", "-p", "testbed:seed:=3"])
    testbed = TestbedNode()
    with spin_in_thread(testbed):
        until(lambda: testbed.ready or testbed.failed)
        assert testbed.ready, testbed.failed
        mcs = McsNode()
        listener = rclpy.create_node("listener")
        with spin_in_thread(mcs), spin_in_thread(listener):
            until(lambda: mcs.ready or mcs.failed)
            assert mcs.ready, mcs.failed
            client = Client(listener)
            until(lambda: client.states)
            yield client
    rclpy.try_shutdown()


@pytest.fixture
def client(machine):
    machine.to_cold()
    until(lambda: machine.state() == "cold")
    return machine


def test_a_session(client):
    assert client.lifecycle() == "inactive"
    answer = client.trigger("power_on")
    assert not answer.success
    assert answer.message == "power_on is refused in state cold; allowed here: cleanup, reserve"
    answer = client.call(ReserveGroup, "/mcs/reserve", group="lefft")
    assert "there is no group 'lefft'; did you mean 'left'?" in answer.message
    client.to_motion()
    assert client.lifecycle() == "active"
    until(lambda: client.state() == "motion")
    assert list(client.states[-1].reserved_groups) == ["left"]
    assert not client.states[-1].brakes

    told = []
    result = client.move(TARGET, feedback=lambda m: told.append(m.feedback.progress))
    assert result.success, result.status.message
    assert told == sorted(told)
    state = result.state
    assert state.at_rest
    np.testing.assert_allclose(state.q_rest, TARGET, atol=1e-4)
    covariance = np.array(state.q_rest_covariance).reshape(9, 9)
    assert (np.sqrt(np.diag(covariance)) > 0).all()
    assert (np.sqrt(np.diag(covariance)) < 1e-4).all()
    assert len(state.jacobian) == 54
    assert state.rest_window == 44

    stamp = state.stamp
    again = client.group_state()
    assert again.q_rest == state.q_rest
    assert again.stamp == stamp  # asking lets no time pass

    assert client.trigger("disable_motion").success
    assert client.trigger("power_off").success
    assert client.lifecycle() == "inactive"
    assert client.call(ReserveGroup, "/mcs/release", group="left").success
    until(lambda: client.state() == "cold")


def test_standard_topics(client):
    client.to_motion()
    assert client.move(TARGET).success
    cell = load_cell()
    until(lambda: client.description and len(client.frames) > 2 and len(client.joints) > 20)
    assert tuple(client.joints[-1].name) == cell.joint_names
    stamps = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in client.joints[-20:]]
    np.testing.assert_allclose(np.diff(stamps), 0.02, atol=0.0046)
    assert "left_j1" in client.description[-1].data
    children = {t.child_frame_id for m in client.frames for t in m.transforms}
    assert {"left_cart", "left_link6", "left_wrist", "left_led", "right_wrist"} <= children


def test_wrong_goals_say_why_and_move_nothing(client):
    client.to_motion()
    before = client.group_state().q_rest
    wide, nan = HOME.copy(), HOME.copy()
    wide[3], nan[4] = 3.0, math.nan
    for points, options, message in (
        ([wide], {}, "left_j1: position of point 1 3 rad is beyond the limit 2.787"),
        ([nan], {}, "point 1: left_j2: position nan is not a finite number"),
        ([HOME[:8]], {}, "point 1 of the path has 8 positions, 9 are needed"),
        ([], {}, "the path of group 'left' has no points"),
        ([HOME], {"names_": [f"left_j{k}" for k in range(1, 10)]}, "there is no joint of group 'left' 'left_j7'"),
    ):
        result = client.move(*points, **options)
        assert not result.success
        assert message in result.status.message
    assert client.group_state().q_rest == before


def test_kinematics_and_paths(client):
    client.to_motion()
    assert client.move(HOME).success
    state = client.group_state()
    pose = state.wrist
    pose.position.z -= 0.15
    answer = client.call(InverseKinematics, "/mcs/inverse_kinematics", group="left", wrist=pose, avoid_collisions=True)
    assert answer.success, answer.status.message
    points = [JointTrajectoryPoint(positions=q) for q in (state.q_rest, answer.q)]
    free = client.call(CheckPath, "/mcs/check_path", group="left", path=JointTrajectory(points=points))
    assert free.success
    assert free.clearance > 0.02
    result = client.move(answer.q)
    assert result.success
    assert result.state.wrist.position.z == pytest.approx(pose.position.z, abs=5e-4)

    far = Pose()
    far.position.z, far.orientation.w = 9.0, 1.0
    answer = client.call(InverseKinematics, "/mcs/inverse_kinematics", group="left", wrist=far)
    assert not answer.success
    assert "left_wrist at (0.000, 0.000, 9.000) m is out of reach" in answer.status.message


def test_gripper(client):
    client.to_motion()
    assert client.call(SetGripper, "/mcs/set_gripper", gripper="left_gripper", close=True).opening == 0.0
    answer = client.call(SetGripper, "/mcs/set_gripper", gripper="left_gripper", close=False)
    assert answer.opening == pytest.approx(0.08)
    answer = client.call(SetGripper, "/mcs/set_gripper", gripper="gripper", close=True)
    assert "there is no gripper 'gripper'" in answer.message


def test_estop_in_the_middle_of_a_move(client):
    client.to_motion()
    moving = threading.Event()
    far = HOME.copy()
    far[0] += 1.0
    _, result = client.start_move(far, HOME, far, HOME, far, feedback=lambda _: moving.set())
    assert moving.wait(5.0)
    assert client.trigger("estop").success
    assert "emergency stop: request on /mcs/estop" in result().status.message
    until(lambda: client.state() == "estopped")
    assert client.lifecycle() == "inactive"
    assert "request on /mcs/estop" in client.states[-1].reason
    assert "allowed here: reset" in client.trigger("power_on").message
    assert client.trigger("reset").success
    assert client.call(ReserveGroup, "/mcs/reserve", group="left").success
    assert client.trigger("power_on").success
    stopped = client.group_state().q
    assert client.trigger("enable_motion").success
    np.testing.assert_allclose(client.group_state().q_rest, stopped, atol=2e-4)  # the arm never leaps
    assert client.move(HOME).success


def test_cancel(client):
    client.to_motion()
    moving = threading.Event()
    far = HOME.copy()
    far[0] += 1.0
    handle, result = client.start_move(far, HOME, far, HOME, far, feedback=lambda _: moving.set())
    assert moving.wait(5.0)
    _wait(handle.cancel_goal_async())
    answer = result()
    assert answer.status.code == "cancelled"
    assert answer.state.at_rest
    assert client.move(HOME).success


def test_unconfigured(client):
    assert client.change("cleanup")
    assert client.lifecycle() == "unconfigured"
    assert client.trigger("power_on").message == UNCONFIGURED
    assert client.call(ReserveGroup, "/mcs/reserve", group="left").message == UNCONFIGURED
    assert client.call(GetGroupState, "/mcs/get_group_state", group="left").status.message == UNCONFIGURED
    assert client.move(HOME).status.message == UNCONFIGURED
    assert client.change("configure")
    assert client.lifecycle() == "inactive"
    client.call(ReserveGroup, "/mcs/reserve", group="left")
    assert not client.change("cleanup")  # refused: a group is reserved
    assert client.change("activate")
    until(lambda: client.state() == "active")
    assert client.change("deactivate")
    until(lambda: client.state() == "reserved")


def test_a_killed_servo_ends_the_goal_and_the_testbed_brakes(client):
    client.to_motion()
    moving = threading.Event()
    far = HOME.copy()
    far[0] += 1.0
    _, result = client.start_move(far, HOME, far, HOME, far, feedback=lambda _: moving.set())
    assert moving.wait(5.0)
    link = TestbedLink.attach(names.instance(), 1.0)
    os.kill(link.read_truth().servo_pid, signal.SIGKILL)
    assert "the process im_mcs.servo ended with code -9" in result().status.message
    until(lambda: client.state() == "unconfigured")
    link.request_time(1, 2)
    until(lambda: link.read_state().brakes.all() and not link.read_state().power)
    assert client.lifecycle() == "unconfigured"
    link.close()
    assert client.change("configure")
    until(lambda: client.state() == "cold")


def test_a_killed_node_takes_its_servo_along(client, process):
    assert client.change("cleanup")
    other = process(sys.executable, "-m", "im_mcs.ros.node", "--ros-args", "-p", "standalone:=true", "-r", "__ns:=/x")
    link = TestbedLink.attach(names.instance(), 1.0)
    until(lambda: link.read_truth().servo_pid != 0, 15.0)
    servo = link.read_truth().servo_pid
    other.kill()
    until(lambda: not os.path.exists(f"/proc/{servo}"))
    link.request_time(1, 2)
    until(lambda: link.read_truth().servo_pid == 0)
    assert link.read_state().brakes.all()
    link.close()
    assert client.change("configure")


def test_a_killed_testbed_ends_the_goal_and_is_named(client):
    """The last one: the testbed does not come back."""
    client.to_motion()
    moving = threading.Event()
    far = HOME.copy()
    far[0] += 1.0
    _, result = client.start_move(far, HOME, far, HOME, far, feedback=lambda _: moving.set())
    assert moving.wait(5.0)
    os.kill(_physics(), signal.SIGKILL)
    assert "the testbed's physics process is gone" in result().status.message
    until(lambda: client.state() == "estopped")
    assert client.lifecycle() == "inactive"
    answer = client.trigger("reset")
    assert not answer.success
    assert "the testbed does not answer" in answer.message


def _physics():
    """Process id of this test's physics."""
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if b"im_sim.physics" in words and names.instance().encode() in words:
            return int(entry.name)
    raise AssertionError("there is no physics process")
