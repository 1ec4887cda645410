"""Node ``/mcs`` with the simulated testbed at clock factor 0, and what a user does to it."""

import contextlib
import threading

import numpy as np
import pytest
import rclpy
from control_msgs.action import FollowJointTrajectory
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectoryPoint

from im_cell.link import PanelEnd, ServoEnd
from im_cell.robot import load_cell
from im_core import clock, names
from im_core.ros import qos
from im_core.ros.calls import call_blocking
from im_core.ros.guard import GuardedActionClient, GuardedNode
from im_core.ros.run import spin_in_thread
from im_mcs.ros.node import McsNode
from im_msgs.action import Move
from im_msgs.msg import McsState
from im_msgs.srv import GetGroupState, ReserveGroup
from im_sim.ros.node import TestbedNode
from support.mcs_config import write_mcs_config
from support.stranger import Stranger

#: So long hundreds of goals may take on a slow computer, whose states rclpy tells again with each that ends [s].
PATIENCE_S = 600.0

#: A short way of an arm on its cart, or of an arm alone [m or rad].
STEP = np.array([0.05, 0.1, 0.05, 0.2, -0.2, 0.2, 0.3, 0.3, 0.3])


def wait(future, seconds=PATIENCE_S):
    """The result of a future of rclpy."""
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    assert done.wait(seconds), "no answer"
    return future.result()


class Client:
    """What a user does to ``/mcs``; the first arm unless told otherwise."""

    def __init__(self, node, mcs):
        self.node, self.mcs = node, mcs
        self.cell = load_cell()
        self.group = next(iter(self.cell.groups))
        self.joints = list(self.cell.joints_of(self.group))
        self.home = self.cell.home[: len(self.joints)]
        self.step = STEP[-len(self.joints) :]
        # so that a metre or radian of the first joint takes some seconds in each cell
        self.slow = min(1.0, 0.6 / self.cell.joints[0].limits.velocity)
        self.states, self.positions, self.frames, self.description = [], [], [], []
        node.create_subscription(McsState, "/mcs/state", self.states.append, qos.LATCHED)
        node.create_subscription(JointState, "/joint_states", self.positions.append, qos.EVENTS)
        node.create_subscription(TFMessage, "/tf", self.frames.append, qos.EVENTS)
        node.create_subscription(TFMessage, "/tf_static", self.frames.append, qos.LATCHED)
        node.create_subscription(String, "/robot_description", self.description.append, qos.LATCHED)
        self._clients = {}

    @staticmethod
    def until(condition, seconds=PATIENCE_S):
        """Wait until a condition is true; returns its value."""
        deadline = clock.monotonic() + seconds
        while not (value := condition()):
            assert clock.monotonic() < deadline, "waited in vain"
            clock.sleep(0.01)
        return value

    def call(self, service_type, name, **fields):
        """Call a service of ``/mcs``, by its name below that or the whole name."""
        whole = name if name.startswith("/") else f"/mcs/{name}"
        client = self._clients.get(name) or self.node.create_client(service_type, whole)
        self._clients[name] = client
        return call_blocking(client, service_type.Request(**fields), PATIENCE_S, name)

    def trigger(self, name):
        return self.call(Trigger, name)

    def listen(self, message_type, topic, profile=qos.EVENTS):
        """A list that grows with the messages of a topic."""
        messages = []
        subscription = self.node.create_subscription(message_type, topic, messages.append, profile)
        self.until(subscription.get_publisher_count)
        return messages

    def talk(self, message_type, topic):
        """A publisher that ``/mcs`` listens to."""
        publisher = self.node.create_publisher(message_type, topic, qos.EVENTS)
        self.until(publisher.get_subscription_count)
        return publisher

    def send(self, action_type, name, goal, feedback=None):
        """Send a goal; its handle."""
        if name not in self._clients:
            self._clients[name] = GuardedActionClient(self.node, action_type, name)
            assert self._clients[name].wait_for_server(60.0), f"no server of {name}"
            clock.sleep(0.5)  # the server must have discovered the client, too, or its answer is lost; nothing tells
        return wait(self._clients[name].send_goal_async(goal, feedback_callback=feedback))

    def act(self, action_type, name, goal, feedback=None):
        """Send a goal; its handle, and a function that waits for the result."""
        handle = self.send(action_type, name, goal, feedback)
        result = handle.get_result_async()
        return handle, lambda: wait(result)

    @staticmethod
    def move_goal(*points, names=(), **fields):
        """A goal of a move through some points of joints."""
        goal = Move.Goal(**fields)
        goal.path.joint_names = list(names)
        goal.path.points = [JointTrajectoryPoint(positions=[float(x) for x in point]) for point in points]
        return goal

    def start_move(self, *points, group="", feedback=None, **fields):
        """Begin a move; its handle, and a function that waits for the result."""
        handle, result = self.act(Move, f"/{group or self.group}/move", self.move_goal(*points, **fields), feedback)
        return handle, lambda: result().result

    def move(self, *points, **options):
        return self.start_move(*points, **options)[1]()

    def rest(self):
        """The positions of the arm once it rests, which a trajectory that has ended does not wait for."""
        return self.until(lambda: (state := self.group_state()).at_rest and state).q_rest

    def follow(self, goal, feedback=None):
        return self.act(FollowJointTrajectory, f"/{self.group}/follow_joint_trajectory", goal, feedback)

    def start_far_move(self, **fields):
        """A move of some seconds that is under way: its handle, and a function that waits for the result."""
        moving = threading.Event()
        far = self.home.copy()
        far[0] += 1.0
        fields["speed_scale"] = min(self.slow, fields.get("speed_scale", 1.0))
        started = self.start_move(far, self.home, far, self.home, far, feedback=lambda _: moving.set(), **fields)
        assert moving.wait(60.0)
        return started

    def cancel(self, handle):
        return wait(handle.cancel_goal_async())

    def lifecycle(self):
        return self.call(GetState, "get_state").current_state.label

    def change(self, label):
        return self.call(ChangeState, "change_state", transition=Transition(label=label)).success

    def state(self):
        return self.states[-1].state

    def status(self, group=""):
        """What ``/mcs/state`` says of a group."""
        return next(status for status in self.states[-1].groups if status.group == (group or self.group))

    def group_state(self, group=""):
        answer = self.call(GetGroupState, "get_group_state", group=group or self.group)
        assert answer.success, answer.status.message
        return answer.state

    def to_motion(self, group="", **reservation):
        for answer in (
            self.call(ReserveGroup, "reserve", group=group or self.group, **reservation),
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
        self.until(lambda: self.state() == "cold")


@pytest.fixture(scope="module")
def owner_silence_s():
    """For how long the servo waits for heartbeats of MCS [s]: here that shares its interpreter with its clients."""
    return 60.0


@pytest.fixture(scope="module")
def cell_name():
    """The cell of the machine; a module has its own, or several."""
    return "puma_pair"


@pytest.fixture(scope="module")
def machine(tmp_path_factory, owner_silence_s, cell_name):
    """Testbed at clock factor 0, MCS, and a client.

    A protective stop waits ten minutes to be resumed: without a clock, five seconds are over before a busy computer
    lets the client ask.
    """
    config = write_mcs_config(
        tmp_path_factory.mktemp("mcs"),
        protective={"patience_s": 600.0},
        safety={"owner_silence_s": owner_silence_s},
    )
    parameters = {"testbed:factor": 0.0, "testbed:seed": 3, "mcs:config": config}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(names.CELL, cell_name)
        with _machine(TestbedNode, McsNode, parameters=parameters) as client:
            yield client


@pytest.fixture
def run_machine():
    """What runs a machine with a configuration of the test's own, until the end of a ``with`` block."""

    def running(config, **parameters):
        settings = {
            "testbed:factor": 0.0,
            "mcs:config": config,
            **{f"mcs:{name}": parameters[name] for name in parameters},
        }
        return _machine(TestbedNode, McsNode, parameters=settings)

    return running


@pytest.fixture
def without_testbed(tmp_path):
    """Starts MCS alone, with parameters; a client. An emergency stop does not outlive the test."""
    with pytest.MonkeyPatch.context() as patch, contextlib.ExitStack() as stack:
        patch.setenv("IM_RUN_DIR", str(tmp_path))
        yield lambda **parameters: stack.enter_context(_machine(McsNode, parameters=parameters))


@contextlib.contextmanager
def _machine(*node_types, parameters):
    """Nodes of which the last is MCS, and a client."""
    settings = [text for name, value in parameters.items() for text in ("-p", f"{name}:={value}")]
    told = ["-p", "standalone:=true", "-p", "introspection:=contents"]  # as a deployment has it
    rclpy.init(args=["--ros-args", *told, *settings])
    try:
        with contextlib.ExitStack() as stack:
            mcs = [stack.enter_context(_running(node_type())) for node_type in node_types][-1]
            listener = GuardedNode("listener")
            stack.enter_context(spin_in_thread(listener))
            client = Client(listener, mcs)
            client.until(lambda: client.states)
            yield client
    finally:
        rclpy.try_shutdown()


@contextlib.contextmanager
def _running(node):
    """A node that has started, until the end of the block."""
    with spin_in_thread(node):
        Client.until(lambda: node.ready or node.failed)
        assert node.ready, node.failed
        yield node


@pytest.fixture(scope="module")
def stranger(machine):
    """A stranger to the machine."""
    node = Stranger()
    yield node
    node.end()


@pytest.fixture
def client(machine):
    """A user of a cold machine."""
    machine.to_cold()
    return machine


@pytest.fixture
def ready(client):
    """A user whose arm is in motion state, at home."""
    client.to_motion()
    result = client.move(client.home)
    assert result.success, result.status.message
    return client


@pytest.fixture
def panel():
    with PanelEnd.attach(names.instance(), 60.0) as end:
        yield end


@pytest.fixture
def testbed():
    with ServoEnd.attach(names.instance(), 60.0) as end:
        yield end
