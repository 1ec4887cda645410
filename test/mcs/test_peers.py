"""What users of ros2_control type: plain rclpy, with the names and types that its controllers have."""

import threading

import numpy as np
import pytest
from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory
from control_msgs.srv import QueryTrajectoryState
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectoryPoint

from im_core import clock

PATIENCE_S = 600.0


class Stranger(Node):
    """A node that knows nothing of this workspace, and a thread that spins it."""

    def __init__(self):
        super().__init__("stranger")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)
        self._actions = {}
        self._thread = threading.Thread(target=self._executor.spin)
        self._thread.start()

    def end(self):
        self._executor.shutdown()
        self._thread.join()
        for action in self._actions.values():
            action.destroy()
        self.destroy_node()

    @staticmethod
    def wait(future):
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        assert done.wait(PATIENCE_S), "no answer"
        return future.result()

    def call(self, kind, name, **fields):
        service = self.create_client(kind, name)
        assert service.wait_for_service(PATIENCE_S), name
        answer = self.wait(service.call_async(kind.Request(**fields)))
        self.destroy_client(service)
        return answer

    def send(self, kind, name, goal, feedback=None):
        """Send a goal; its handle."""
        if name not in self._actions:
            self._actions[name] = ActionClient(self, kind, name)
            assert self._actions[name].wait_for_server(PATIENCE_S), name
            clock.sleep(0.5)  # the server must have discovered the client, too
        return self.wait(self._actions[name].send_goal_async(goal, feedback_callback=feedback))


@pytest.fixture(scope="module")
def stranger(machine):
    """A stranger to the machine."""
    node = Stranger()
    yield node
    node.end()


def to_ns(time):
    return time.sec * 1_000_000_000 + time.nanosec


def stamp(nanoseconds):
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


def query(stranger, nanoseconds, group="left"):
    return stranger.call(QueryTrajectoryState, f"/{group}/query_state", time=stamp(nanoseconds))


def test_a_trajectory_is_asked_where_it_is_at_a_time(ready, stranger):
    """The first answers are those of JTC where it is not active, and where it has nothing to follow."""
    answer = query(stranger, 0)
    assert (answer.success, answer.message) == (False, "no trajectory is followed")
    assert "group 'transporter'" in query(stranger, 0, "transporter").message
    seconds, far = 300, (np.array(ready.home) + 0.1).tolist()
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = ready.joints
    goal.trajectory.points = [JointTrajectoryPoint(positions=far, time_from_start=Duration(sec=seconds))]
    told = []
    handle = stranger.send(FollowJointTrajectory, "/left/follow_joint_trajectory", goal, told.append)
    ready.until(lambda: told)
    desired, now_ns = told[0].feedback.desired, to_ns(told[0].feedback.header.stamp)
    begin_ns = now_ns - to_ns(desired.time_from_start)
    end_ns, close_ns = begin_ns + seconds * 1_000_000_000, 50_000_000
    for time_ns, q in ((now_ns, desired.positions), (begin_ns + close_ns, ready.home), (end_ns - close_ns, far)):
        answer = query(stranger, time_ns)
        assert answer.success, answer.message
        assert list(answer.name) == ready.joints
        np.testing.assert_allclose(answer.position, q, atol=1e-4)
        assert len(answer.velocity) == len(answer.acceleration) == len(ready.joints)
    assert not query(stranger, begin_ns - close_ns).success
    assert "which goes from 0 to 300.000 s" in query(stranger, end_ns + close_ns).message
    stranger.wait(handle.cancel_goal_async())
    stranger.wait(handle.get_result_async())
    assert query(stranger, end_ns - close_ns).message == "no trajectory is followed"


def test_a_group_that_is_cold_has_no_state_to_ask_for(client, stranger):
    answer = query(stranger, 0)
    assert not answer.success
    assert "query is refused in state cold" in answer.message
