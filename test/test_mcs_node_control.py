"""``/mcs/set_controller``: the control law changed through ROS, in the middle of a motion."""

import threading

import numpy as np
import pytest
import rclpy
from rclpy.action import ActionClient
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectoryPoint

from im_core import clock
from im_core.robot import load_cell
from im_core.ros.calls import call_blocking
from im_core.ros.run import spin_in_thread
from im_mcs.ros.node import McsNode
from im_msgs.action import Move
from im_msgs.srv import ReserveGroup, SetController
from im_sim.ros.node import TestbedNode

COMPUTED_TORQUE = "im_mcs.control.computed_torque:ComputedTorque"
TARGET = load_cell().home[:9] + np.array([0.05, 0.2, 0.1, 0.6, -0.5, 0.6, 0.3, 0.3, 0.3])


def until(condition, seconds=20.0):
    deadline = clock.monotonic() + seconds
    while not condition():
        assert clock.monotonic() < deadline, "waited in vain"
        clock.sleep(0.01)


def result_of(future):
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    assert done.wait(20.0), "no answer"
    return future.result()


@pytest.fixture(scope="module")
def listener():
    """Testbed at clock factor 0, MCS, and a node that asks."""
    rclpy.init(args=["--ros-args", "-p", "standalone:=true", "-p", "testbed:factor:=0.0", "-p", "testbed:seed:=4"])
    testbed = TestbedNode()
    with spin_in_thread(testbed):
        until(lambda: testbed.ready or testbed.failed)
        assert testbed.ready, testbed.failed
        mcs, listener = McsNode(), rclpy.create_node("listener")
        with spin_in_thread(mcs), spin_in_thread(listener):
            until(lambda: mcs.ready or mcs.failed)
            assert mcs.ready, mcs.failed
            yield listener
    rclpy.try_shutdown()


@pytest.fixture
def call(listener):
    def call(service_type, name, **fields):
        client = listener.create_client(service_type, f"/mcs/{name}")
        try:
            return call_blocking(client, service_type.Request(**fields), 15.0, name)
        finally:
            listener.destroy_client(client)

    return call


def test_a_law_takes_over_in_the_middle_of_a_motion(listener, call):
    answer = call(SetController, "set_controller", group="left", controller=COMPUTED_TORQUE)
    assert "set_controller is refused in state cold" in answer.message
    assert call(ReserveGroup, "reserve", group="left").success
    for trigger in ("power_on", "enable_motion"):
        answer = call(Trigger, trigger)
        assert answer.success, answer.message

    move = ActionClient(listener, Move, "/left/move")
    assert move.wait_for_server(10.0)
    goal = Move.Goal()
    goal.path.points = [JointTrajectoryPoint(positions=TARGET.tolist())]
    pending = result_of(move.send_goal_async(goal)).get_result_async()
    answer = call(SetController, "set_controller", group="left", controller=COMPUTED_TORQUE)
    assert answer.success, answer.message
    assert answer.message == f"{COMPUTED_TORQUE} takes over left"
    result = result_of(pending).result
    assert result.success, result.status.message
    np.testing.assert_allclose(result.state.q_rest, TARGET, atol=5e-5)
    move.destroy()


@pytest.mark.parametrize(
    ("group", "controller", "sentence"),
    [
        ("left", "os:system", "there is no control law 'os:system'"),
        ("left", "", "there is no control law ''"),
        ("lefft", COMPUTED_TORQUE, "did you mean 'left'"),
        ("right", COMPUTED_TORQUE, "group 'right' is not reserved"),
    ],
)
def test_wrong_requests_are_refused_with_the_reason(call, group, controller, sentence):
    call(ReserveGroup, "reserve", group="left")  # refused if it is reserved already
    answer = call(SetController, "set_controller", group=group, controller=controller)
    assert not answer.success
    assert sentence in answer.message
