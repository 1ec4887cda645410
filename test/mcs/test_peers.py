"""What users of ros2_control type: plain rclpy, with the names and types that its controllers have."""

import numpy as np
import pytest
from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory, ParallelGripperCommand
from control_msgs.msg import DynamicJointState, JointTrajectoryControllerState, SpeedScalingFactor
from control_msgs.srv import QueryTrajectoryState
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectoryPoint

from im_msgs.srv import PutInJaws, ReserveGroup, SetGripper, SetSpeed

SUCCEEDED, ABORTED = 4, 6


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
    stranger.ask(handle.cancel_goal_async)
    stranger.ask(handle.get_result_async)
    assert query(stranger, end_ns - close_ns).message == "no trajectory is followed"


def test_a_group_that_is_cold_has_no_state_to_ask_for(client, stranger):
    answer = query(stranger, 0)
    assert not answer.success
    assert "query is refused in state cold" in answer.message


@pytest.fixture
def grip(client, stranger):
    """``grip(position, name=, effort=)``: a goal for the left gripper, which is wide open; its result and feedback."""
    client.to_motion()
    assert client.call(SetGripper, "set_gripper", gripper="left_gripper", close=False).success

    def send(*position, **fields):
        goal, told = ParallelGripperCommand.Goal(command=JointState(position=position, **fields)), []
        name = "/left_gripper/parallel_gripper_action_controller/gripper_cmd"
        handle = stranger.send(ParallelGripperCommand, name, goal, told.append)
        return stranger.ask(handle.get_result_async), told

    return send


@pytest.fixture
def sponge(stranger):
    """Something of 0.05 m between the left jaws, which is taken away in the end."""
    given = {"gripper": "left_gripper", "stiffness": 1e4, "mass": 0.1}
    assert stranger.call(PutInJaws, "/testbed/put_in_jaws", width=0.05, **given).success
    yield
    assert stranger.call(PutInJaws, "/testbed/put_in_jaws", width=0.0, **given).success


def test_a_parallel_gripper_goes_where_it_is_told(grip):
    """Name and effort are optional; MoveIt sends a velocity, which bounds nothing where there is no such interface."""
    for position, more in (
        (0.03, {}),
        (0.08, {"name": ["left_gripper"], "effort": [5.0]}),
        (0.05, {"velocity": [0.0], "effort": [0.0]}),
    ):
        answer, _ = grip(position, **more)
        result = answer.result
        assert (answer.status, result.reached_goal, result.stalled) == (SUCCEEDED, True, False)
        assert list(result.state.name) == ["left_gripper"]
        assert result.state.position[0] == pytest.approx(position, abs=1e-3)
        assert len(result.state.effort) == 1
        assert to_ns(result.state.header.stamp) > 0


def test_what_a_parallel_gripper_holds_stalls_it_at_its_effort(grip, sponge):
    answer, told = grip(0.0, effort=[20.0])
    result = answer.result
    assert (answer.status, result.reached_goal, result.stalled) == (SUCCEEDED, False, True)
    assert result.state.position[0] == pytest.approx(0.048, abs=1e-3)
    assert result.state.effort[0] == pytest.approx(20.0, abs=2.0)
    assert all(list(message.feedback.state.name) == ["left_gripper"] for message in told)


@pytest.mark.parametrize(
    ("position", "more"),
    [
        ((), {}),
        ((0.01, 0.01), {}),
        ((0.5,), {}),
        ((float("nan"),), {}),
        ((0.01,), {"name": ["finger"]}),
        ((0.01,), {"effort": [1.0, 1.0]}),
        ((0.01,), {"effort": [-1.0]}),
    ],
)
def test_a_command_that_no_parallel_gripper_has_moves_nothing(grip, position, more):
    answer, _ = grip(*position, **more)
    assert (answer.status, answer.result.reached_goal) == (ABORTED, False)
    assert answer.result.state.position[0] == pytest.approx(0.08, abs=1e-3)


def test_all_that_is_measured_is_there_by_joint_and_sensor(ready, stranger):
    """As joint_state_broadcaster publishes it: what /joint_states has, and what it has no room for."""
    dynamic, plain = [], []
    stranger.create_subscription(DynamicJointState, "/dynamic_joint_states", dynamic.append, 10)
    stranger.create_subscription(JointState, "/joint_states", plain.append, 10)
    by_stamp = {}

    def told():
        by_stamp.update((to_ns(message.header.stamp), message) for message in plain)
        return next((each for each in dynamic if to_ns(each.header.stamp) in by_stamp), None)

    message = ready.until(told)
    same = by_stamp[to_ns(message.header.stamp)]
    values = [dict(zip(each.interface_names, each.values, strict=True)) for each in message.interface_values]
    assert list(message.joint_names) == [*same.name, "left_force", "right_force"]
    of = dict(zip(message.joint_names, values, strict=True))
    for rank, name in enumerate(same.name):
        for interface in ("position", "velocity", "effort"):
            assert of[name][interface] == pytest.approx(getattr(same, interface)[rank], nan_ok=True)
    assert of["left_j1"].keys() == {"position", "velocity", "effort", "age", "brake"}
    assert (of["left_j1"]["brake"], of["right_j1"]["brake"]) == (0.0, 1.0)
    assert of["left_gripper"].keys() == {"position", "velocity", "effort"}
    assert list(of["left_force"]) == ["force.x", "force.y", "force.z", "torque.x", "torque.y", "torque.z"]


@pytest.fixture
def scale(ready, stranger):
    """``scale(factor)`` as ``ros2 topic pub --qos-durability transient_local --once`` does; whole speed in the end."""
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = stranger.create_publisher(SpeedScalingFactor, "/left/speed_scaling_input", latched)
    ready.until(publisher.get_subscription_count)
    yield lambda factor: publisher.publish(SpeedScalingFactor(factor=factor))
    stranger.destroy_publisher(publisher)
    assert ready.call(SetSpeed, "set_speed", group="left", scale=1.0).success


def refusals(told):
    """Refused messages of the topic of speeds."""
    values = [value for message in told for status in message.status for value in status.values]
    return max((int(value.value) for value in values if value.key == "/left/speed_scaling_input"), default=0)


def test_a_factor_on_a_topic_scales_the_speed_down_to_a_halt(ready, stranger, scale):
    rates, diagnostics = [], ready.listen(DiagnosticArray, "/diagnostics")
    topic = "/left/controller_state"
    listening = stranger.create_subscription(
        JointTrajectoryControllerState, topic, lambda told: rates.append(told.speed_scaling_factor), 10
    )
    ready.until(lambda: rates and rates[-1] == 1.0)
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = ready.joints
    far = (np.array(ready.home) + 0.1).tolist()
    goal.trajectory.points = [JointTrajectoryPoint(positions=far, time_from_start=Duration(sec=20))]
    handle = stranger.send(FollowJointTrajectory, "/left/follow_joint_trajectory", goal)
    for factor in (0.5, 0.0):
        scale(factor)
        ready.until(lambda factor=factor: rates[-1] == pytest.approx(factor))
    ready.until(lambda: diagnostics and ready.status().paused)
    before = refusals(diagnostics)
    scale(-0.5)
    ready.until(lambda: refusals(diagnostics) > before)
    assert rates[-1] == 0.0
    answer = ready.call(SetSpeed, "set_speed", group="left", scale=0.0)
    assert answer.message == "left does not move at 0 of the planned speed; pause it (/mcs/pause)"
    scale(1.0)
    result = stranger.ask(handle.get_result_async)
    assert (result.status, result.result.error_code) == (SUCCEEDED, 0)
    stranger.destroy_subscription(listening)


def test_a_group_with_an_owner_does_not_obey_a_topic(ready, scale):
    diagnostics = ready.listen(DiagnosticArray, "/diagnostics")
    assert ready.call(ReserveGroup, "take_over", group="left", owner="listener").success
    ready.until(lambda: diagnostics and ready.status().owner == "listener")
    before = refusals(diagnostics)
    scale(0.5)
    ready.until(lambda: refusals(diagnostics) > before)
    assert ready.status().speed == 1.0
    assert ready.call(ReserveGroup, "take_over", group="left").success
