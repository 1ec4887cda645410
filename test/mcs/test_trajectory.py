"""``/<group>/follow_joint_trajectory`` and ``/<group>/joint_trajectory``, as users of ros2_control expect them."""

import math
import re
import threading

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance, JointTrajectoryControllerState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint, MultiDOFJointTrajectoryPoint

from im_core import clock
from im_core.ros import qos
from im_core.ros.calls import pause
from im_mcs.limits.configuration import load_config
from im_mcs.ros.access import McsAccess
from im_mcs.ros.actions import trajectory_server
from im_msgs.action import Move
from im_msgs.msg import GroupSetpoints
from support.motions import duration, far, goal, now, stamp, started, trajectory

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
Result = FollowJointTrajectory.Result
MOST_POINTS = load_config().planning.max_trajectory_points
STEP = np.array([0.05, 0.1, 0.05, 0.2, -0.2, 0.2, 0.3, 0.3, 0.3])
ORDER = [4, 0, 8, 2, 6, 1, 3, 7, 5]


def seconds(time):
    return time.sec + 1e-9 * time.nanosec


def test_joints_in_any_order_with_velocities_and_feedback(ready):
    target, told = ready.home + STEP, []
    shuffled = [ready.joints[i] for i in ORDER]
    request = goal(ready, (1.0, (ready.home + STEP / 2)[ORDER]), (2.0, target[ORDER]), joints=shuffled)
    request.trajectory.points[0].velocities = list((STEP / 2)[ORDER])
    request.trajectory.points[1].velocities = [0.0] * 9
    began = now(ready)
    answer = ready.follow(request, lambda message: told.append(message.feedback))[1]()
    assert answer.status == SUCCEEDED, answer.result.error_string
    assert answer.result.error_code == Result.SUCCESSFUL
    assert now(ready) - began >= 2.0
    np.testing.assert_allclose(ready.rest(), target, atol=1e-4)
    assert len(told) >= 10
    for feedback in told:
        assert list(feedback.joint_names) == ready.joints
        error = np.array(feedback.desired.positions) - feedback.actual.positions
        np.testing.assert_allclose(feedback.error.positions, error, atol=1e-12)
        assert np.abs(error).max() < 0.01
    assert max(abs(f.desired.velocities[3]) for f in told) > 0.05


@pytest.fixture
def goals_told(ready):
    """Goals of the left arm as whoever records hears of them."""
    name = "/left/follow_joint_trajectory/_action/send_goal/_service_event"
    return ready.listen(FollowJointTrajectory.Impl.SendGoalService.Event, name, qos.SERVICE_EVENTS)


def test_a_goal_is_told_as_the_message_that_it_was(ready, goals_told):
    request = goal(ready, (1.0, ready.home + STEP / 2), (1.5, ready.home + STEP))
    handle, result = ready.follow(request)
    assert result().status == SUCCEEDED
    ready.until(lambda: goals_told)
    (told,) = [sent for event in goals_told for sent in event.request]
    assert told.goal == request
    assert bytes(told.goal_id.uuid) == bytes(handle.goal_id.uuid)


@pytest.mark.parametrize(
    ("change", "code", "sentence"),
    [
        (lambda r: r.trajectory.joint_names.pop(), Result.INVALID_JOINTS, "lacks left_j6; all 9 joints are needed"),
        (lambda r: r.trajectory.joint_names.clear(), Result.INVALID_JOINTS, "names no joints"),
        (
            lambda r: r.trajectory.joint_names.__setitem__(0, "left_trakc"),
            Result.INVALID_JOINTS,
            "'left_trakc'; did you mean 'left_track'",
        ),
        (lambda r: r.trajectory.joint_names.append("left_j1"), Result.INVALID_JOINTS, "'left_j1' is given 2 times"),
        (lambda r: r.trajectory.points.clear(), Result.INVALID_GOAL, "has no points"),
        (lambda r: r.trajectory.points[1].positions.pop(), Result.INVALID_GOAL, "point 2: position is given for 8"),
        (
            lambda r: r.trajectory.points[1].positions.__setitem__(3, math.nan),
            Result.INVALID_GOAL,
            "point 2: position of left_j1 is nan",
        ),
        (
            lambda r: [p.velocities.extend([x] * 9) for p, x in zip(r.trajectory.points, (math.inf, 0.0), strict=True)],
            Result.INVALID_GOAL,
            "point 1: velocity of left_track is inf",
        ),
        (lambda r: r.trajectory.points[0].effort.extend([0.0] * 9), Result.INVALID_GOAL, "point 1 has efforts"),
        (
            lambda r: setattr(r.trajectory.points[1], "time_from_start", duration(1.0)),
            Result.INVALID_GOAL,
            "does not come after",
        ),
        (
            lambda r: setattr(r.trajectory.points[0], "time_from_start", Duration(sec=-1)),
            Result.INVALID_GOAL,
            "time_from_start -1 s is not >= 0",
        ),
        (
            lambda r: setattr(r.trajectory.points[1], "positions", [9.0] * 9),
            Result.INVALID_GOAL,
            "beyond the limit",
        ),
        (lambda r: setattr(r.trajectory.header, "stamp", stamp(0.001)), Result.OLD_HEADER_TIMESTAMP, "before now"),
        (
            lambda r: r.multi_dof_trajectory.points.append(MultiDOFJointTrajectoryPoint()),
            Result.INVALID_GOAL,
            "multi_dof_trajectory is not empty",
        ),
        (
            lambda r: r.path_tolerance.append(JointTolerance(name="j1", position=0.1)),
            Result.INVALID_JOINTS,
            "path_tolerance: there is no joint of group 'left' 'j1'",
        ),
        (
            lambda r: r.goal_tolerance.append(JointTolerance(name="left_j1", position=math.nan)),
            Result.INVALID_GOAL,
            "goal_tolerance of left_j1: position nan",
        ),
        (lambda r: setattr(r, "goal_time_tolerance", Duration(sec=-3)), Result.INVALID_GOAL, "goal_time_tolerance"),
    ],
)
def test_wrong_goals_are_refused_and_move_nothing(ready_once, change, code, sentence):
    client = ready_once
    before = client.rest()
    request = goal(client, (1.0, client.home + STEP / 2), (2.0, client.home + STEP))
    change(request)
    answer = client.follow(request)[1]()
    assert answer.status == ABORTED
    assert sentence in answer.result.error_string
    assert answer.result.error_code == code
    assert client.group_state().q_rest == before


def test_tolerances_of_velocity_and_acceleration(ready):
    request = far(ready)
    request.path_tolerance = [JointTolerance(name="left_j1", velocity=1e-6)]
    answer = ready.follow(request)[1]()
    assert answer.result.error_code == Result.PATH_TOLERANCE_VIOLATED
    assert "left_j1: velocity error" in answer.result.error_string
    request.path_tolerance = [JointTolerance(name="left_j1", acceleration=1.0)]
    assert "accelerations are not measured" in ready.follow(request)[1]().result.error_string
    assert ready.move(ready.home).success


@pytest.mark.parametrize("seconds", [0.1, 1.0, 0.0])  # before and after it has settled, and as long as that takes
def test_goal_tolerance(ready, seconds):
    request = goal(ready, (1.0, ready.home + STEP))
    request.goal_tolerance = [JointTolerance(name="left_j1", position=1e-9)]
    request.goal_time_tolerance = duration(seconds)
    answer = ready.follow(request)[1]()
    assert answer.status == ABORTED
    assert answer.result.error_code == Result.GOAL_TOLERANCE_VIOLATED
    assert "left_j1" in answer.result.error_string


@pytest.fixture
def allowed(ready):
    """Sets parameters of ``/mcs`` to true, until the end of the test."""
    names = []

    def put(name, value):
        parameter = Parameter(name, value=value).to_parameter_msg()
        assert ready.call(SetParameters, "set_parameters", parameters=[parameter]).results[0].successful

    def allow(name):
        names.append(name)
        put(name, True)

    yield allow
    for name in names:
        put(name, False)


def test_some_of_the_joints_are_followed_where_that_is_allowed(ready, allowed):
    some = [ready.joints[4], ready.joints[0]]
    target = ready.home.copy()
    target[[4, 0]] += [0.1, 0.05]
    request = goal(ready, (1.5, target[[4, 0]]), joints=some)
    assert ready.follow(request)[1]().result.error_code == Result.INVALID_JOINTS
    allowed("allow_partial_joints_goal")
    answer = ready.follow(request)[1]()
    assert answer.status == SUCCEEDED, answer.result.error_string
    np.testing.assert_allclose(ready.rest(), target, atol=1e-4)


def test_a_velocity_at_the_end_is_followed_by_rest_where_that_is_allowed(ready, allowed):
    target, speed = ready.home + 0.2 * np.eye(9)[0], 0.1
    request = goal(ready, (2.0, target))
    request.trajectory.points[0].velocities = list(speed * np.eye(9)[0])
    answer = ready.follow(request)[1]()
    assert answer.result.error_code == Result.INVALID_GOAL
    assert "left_track has velocity 0.1 in its last point" in answer.result.error_string
    allowed("allow_nonzero_velocity_at_trajectory_end")
    answer = ready.follow(request)[1]()
    assert answer.status == SUCCEEDED, answer.result.error_string
    behind = ready.rest() - target
    assert 0.5 * speed**2 / 0.95 < behind[0] < 0.1
    np.testing.assert_allclose(behind[1:], 0.0, atol=1e-4)


def put(client, name, value):
    """The outcome of setting a parameter."""
    parameters = [Parameter(name, value=value).to_parameter_msg()]
    return client.call(SetParameters, "set_parameters", parameters=parameters).results[0]


@pytest.fixture
def bound(ready):
    """``bound(name, value)``: set a parameter; 0 in the end."""
    names = []

    def bound(name, value):
        names.append(name)
        assert put(ready, name, value).successful

    yield bound
    for name in names:
        assert put(ready, name, 0.0).successful


def test_bounds_of_rest_are_those_of_the_parameters(ready, bound):
    bound("settle.timeout_s", 1e-3)
    assert "did not settle" in ready.move(ready.home + 0.05 * np.eye(9)[0]).status.message
    bound("settle.timeout_s", 0.0)
    result = ready.move(ready.home)
    assert result.success, result.status.message


def test_tolerances_of_parameters_hold_where_a_trajectory_names_none(ready, bound):
    target = ready.home + 0.2 * np.eye(9)[0]
    bound("constraints.left_track.trajectory", 1e-9)
    answer = ready.follow(goal(ready, (2.0, target)))[1]().result
    assert answer.error_code == Result.PATH_TOLERANCE_VIOLATED
    assert "left_track: error" in answer.error_string
    named = goal(ready, (2.0, target))
    named.path_tolerance = [JointTolerance(name="left_track", position=0.1)]
    answer = ready.follow(named)[1]()
    assert answer.status == SUCCEEDED, answer.result.error_string


def test_a_goal_of_parameters_is_missed_after_its_time(ready, bound):
    target = ready.home + 0.2 * np.eye(9)[0]
    bound("constraints.left_track.goal", 1e-9)
    bound("constraints.goal_time", 0.5)
    answer = ready.follow(goal(ready, (2.0, target)))[1]().result
    assert answer.error_code == Result.GOAL_TOLERANCE_VIOLATED
    assert "left_track: error" in answer.error_string


def test_a_tolerance_that_is_none_is_refused_with_the_reason(client):
    for value in (-1.0, 11.0, math.nan):
        answer = put(client, "constraints.left_track.goal", value)
        assert not answer.successful
        assert answer.reason


def test_one_point_at_time_0_where_the_arm_is_succeeds(ready):
    here = np.array(ready.group_state().q)
    answer = ready.follow(goal(ready, (0.0, here)))[1]()
    assert answer.status == SUCCEEDED, answer.result.error_string
    np.testing.assert_allclose(ready.rest(), here, atol=1e-4)


def test_a_stream_on_the_topic_is_followed_and_ends_at_rest(ready):
    publisher = ready.talk(JointTrajectory, "/left/joint_trajectory")
    setpoints = ready.listen(GroupSetpoints, "/left/setpoints")
    began, way, speed = now(ready), np.eye(9)[0], 0.2
    refused = ready.mcs._mcs.refusals
    before = refused.counts()

    def send(place, velocity):
        message = trajectory(ready, (0.1, ready.home + place * way))
        message.points[0].velocities = list(velocity * way)
        publisher.publish(message)

    while (passed := now(ready) - began) < 1.5:  # testbed time runs as fast as it can: the arm may rest in between
        send(speed * (passed + 0.1), speed)
        ready.until(lambda passed=passed: now(ready) - began > passed + 0.03)
    send(speed * 1.6, 0.0)

    def arrived():
        state = ready.group_state()
        return state.at_rest and np.allclose(state.q_rest, ready.home + speed * 1.6 * way, atol=1e-4)

    ready.until(arrived)
    # what is shown of the way home may come late
    stamps = [message.stamp.sec + 1e-9 * message.stamp.nanosec for message in setpoints]
    v = np.array([message.velocity for message, at in zip(setpoints, stamps, strict=True) if at > began])
    assert 0.0 < v[:, 0].max() < 0.57
    np.testing.assert_allclose(v[:, 1:], 0.0, atol=1e-9)
    assert refused.counts() == before


def test_windows_as_moveit_servo_sends_them_are_followed_and_end_at_rest(ready):
    """Points of the last 0.4 s and of the next 0.4 s, stamped with the first, the last one with a velocity.

    Time runs as fast as it can here, so the windows are wider than the usual 0.1 s: few are over when they come.
    """
    publisher = ready.talk(JointTrajectory, "/left/joint_trajectory")
    setpoints = ready.listen(GroupSetpoints, "/left/setpoints")
    way, speed, refused = np.eye(9)[8], 0.3, ready.mcs._mcs.refusals
    before, began = refused.counts(), now(ready)
    while (passed := now(ready) - began) < 1.5:
        times = np.arange(max(passed - 0.4, 0.0), passed + 0.4, 0.02)
        points = ((float(t - times[0]), ready.home + speed * t * way) for t in times)
        message = trajectory(ready, *points, start=began + float(times[0]))
        for point in message.points:
            point.velocities = list(speed * way)
        publisher.publish(message)
        ready.until(lambda passed=passed: now(ready) - began > passed + 0.01)
    place = np.array(ready.rest()) - ready.home
    assert 0.0 < place[8] < speed * (now(ready) - began)
    np.testing.assert_allclose(place[:8], 0.0, atol=1e-4)
    v = np.array([message.velocity for message in setpoints])
    assert 0.0 < v[:, 8].max() <= 5.0 * speed  # time goes on until the first one comes: the arm makes up for that
    if refused.counts() != before:  # a busy computer may let some windows pass
        assert "before now" in refused._last["/left/joint_trajectory"]


def long_course(client, count, seconds=8.0):
    """Points of a smooth trajectory, a metre along the track, each with velocities and accelerations."""
    x = np.linspace(1.0 / count, 1.0, count)
    shares = (x**3 * (10.0 - 15.0 * x + 6.0 * x**2), 30.0 * (x - x**2) ** 2 / seconds)
    shares += (60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / seconds**2,)
    request = goal(client)
    for k, time in enumerate(seconds * x):
        point = JointTrajectoryPoint(time_from_start=duration(float(time)))
        for order, name in enumerate(GIVEN):
            row = (client.home if order == 0 else 0.0) + shares[order][k] * np.eye(9)[0]
            setattr(point, name, row.tolist())
        request.trajectory.points.append(point)
    return request


def test_a_trajectory_of_as_many_points_as_are_allowed_is_told_and_followed(ready, goals_told):
    request = long_course(ready, MOST_POINTS)
    answer = ready.follow(request)[1]()
    assert answer.status == SUCCEEDED, answer.result.error_string
    np.testing.assert_allclose(ready.rest(), ready.home + np.eye(9)[0], atol=1e-4)
    ready.until(lambda: goals_told)
    (told,) = [sent for event in goals_told for sent in event.request]
    assert told.goal == request


@pytest.fixture
def held(monkeypatch):
    """Events: a trajectory is about to be sent to the servo, and may be; in the end it may in any case."""
    waiting, go_on = threading.Event(), threading.Event()
    sender = McsAccess.sender

    async def late(access, *arguments):
        if not waiting.is_set():  # what comes later overtakes it
            waiting.set()
            while not go_on.is_set():
                await pause(access.node, 0.01)
        return await sender(access, *arguments)

    monkeypatch.setattr(McsAccess, "sender", late)
    yield waiting, go_on
    go_on.set()


def test_a_goal_that_is_cancelled_before_the_servo_knows_it_does_not_begin(ready, held):
    waiting, go_on = held
    handle, result = ready.follow(far(ready))
    assert waiting.wait(60.0)
    assert len(ready.cancel(handle).goals_canceling) == 1
    go_on.set()
    answer = result()
    assert answer.status == CANCELED
    assert answer.result.error_code == Result.SUCCESSFUL
    np.testing.assert_allclose(ready.rest(), ready.home, atol=1e-4)


def test_a_goal_that_takes_long_to_be_sent_does_not_replace_a_newer_one(ready, held):
    waiting, go_on = held
    _, first = ready.follow(far(ready))
    assert waiting.wait(60.0)
    _, second = started(ready, goal(ready, (4.0, ready.home + STEP)))
    go_on.set()
    answer = first()
    assert answer.status == ABORTED
    assert answer.result.error_code == Result.INVALID_GOAL
    assert answer.result.error_string == "group 'left': replaced by a newer goal"
    assert second().status == SUCCEEDED
    np.testing.assert_allclose(ready.rest(), ready.home + STEP, atol=1e-4)


def test_a_newer_goal_that_is_refused_leaves_one_that_takes_long_alone(ready, held):
    waiting, go_on = held
    _, first = ready.follow(far(ready))
    assert waiting.wait(60.0)
    assert ready.follow(goal(ready, (4.0, ready.home + 100.0)))[1]().status == ABORTED
    go_on.set()
    assert first().status == SUCCEEDED


@pytest.mark.parametrize("on_topic", [True, False])
def test_a_stop_counts_for_what_the_servo_does_not_know_yet(ready, held, on_topic):
    waiting, go_on = held
    publisher = ready.talk(JointTrajectory, "/left/joint_trajectory")
    if on_topic:
        publisher.publish(far(ready).trajectory)
    else:
        _, result = ready.follow(far(ready))
    assert waiting.wait(60.0)
    publisher.publish(JointTrajectory())
    refused = ready.mcs._mcs.refusals
    before = refused.counts()
    publisher.publish(trajectory(ready, (1.0, ready.home), joints=["left_j1"]))
    ready.until(lambda: refused.counts() != before)  # then the stop has been read, too
    go_on.set()
    if on_topic:
        clock.sleep(1.0)
    else:
        assert result().result.error_string == "group 'left': stopped before the motion began"
    np.testing.assert_allclose(ready.rest(), ready.home, atol=1e-4)


def test_what_is_too_long_is_refused_by_its_length(ready_once, monkeypatch):
    def never(*_):
        raise AssertionError("nobody looks at the points")

    monkeypatch.setattr(trajectory_server, "timed_trajectory", never)
    client, topic = ready_once, "/left/joint_trajectory"
    request = goal(client)
    request.trajectory.points = [JointTrajectoryPoint()] * (MOST_POINTS + 1)
    answer = client.follow(request)[1]()
    assert answer.result.error_code == Result.INVALID_GOAL
    sentence = f"the trajectory has {MOST_POINTS + 1} points, {MOST_POINTS} are allowed"
    assert answer.result.error_string == sentence
    refused = client.mcs._mcs.refusals
    before = refused.counts().get(topic, 0)
    client.talk(JointTrajectory, topic).publish(request.trajectory)
    client.until(lambda: refused.counts().get(topic, 0) == before + 1)
    for names, words in ((["x" * 1_000_000], "'xxx"), (["x"] * 1000, "joint_names has 1000 values, 64 are allowed")):
        request = goal(client, (1.0, client.home), joints=names)
        error = client.follow(request)[1]().result.error_string
        assert len(error) < 400
        assert words in error


def test_controller_state_tells_what_was_asked_measured_and_given_out(ready):
    told = ready.listen(JointTrajectoryControllerState, "/left/controller_state")
    answer = ready.follow(goal(ready, (1.0, ready.home + STEP)))[1]()
    assert answer.status == SUCCEEDED, answer.result.error_string
    ready.until(lambda: told and np.allclose(told[-1].reference.positions, ready.home + STEP))
    stamps = [message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec for message in told]
    assert len(set(stamps)) >= 40
    assert np.diff(stamps).max() < 0.03
    for message in told:
        assert list(message.joint_names) == ready.joints
        for name in ("positions", "velocities"):
            wanted, measured = (np.array(getattr(point, name)) for point in (message.reference, message.feedback))
            np.testing.assert_array_equal(getattr(message.error, name), wanted - measured)
        assert len(message.reference.accelerations) == len(message.output.effort) == 9
        asked, since, late = (
            seconds(point.time_from_start) for point in (message.reference, message.feedback, message.error)
        )
        assert late == pytest.approx(asked - since, abs=1e-8)
        assert 0.0 <= asked <= 1.0 + 1e-8
        assert message.speed_scaling_factor == 1.0
    assert {seconds(message.reference.time_from_start) > 0.5 for message in told} == {True, False}
    assert max(abs(message.reference.velocities[3]) for message in told) > 0.05
    assert max(np.abs(message.error.positions).max() for message in told) < 0.01
    assert any(message.output.effort[4] != 0.0 for message in told)  # the shoulder carries the arm


def test_the_rate_of_controller_state_is_a_parameter(ready):
    told = ready.listen(JointTrajectoryControllerState, "/left/controller_state")
    (answer,) = ready.mcs.set_parameters([Parameter("controller_state_rate", value=5.0)])
    assert answer.successful
    try:
        del told[:]
        assert ready.follow(goal(ready, (2.0, ready.home + STEP)))[1]().status == SUCCEEDED
        stamps = {message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec for message in told}
        assert 8 <= len(stamps) <= 1 + 5.0 * (max(stamps) - min(stamps) + 0.2)
    finally:
        ready.mcs.set_parameters([Parameter("controller_state_rate", value=50.0)])
    assert not ready.mcs.set_parameters([Parameter("controller_state_rate", value=0.0)])[0].successful


@pytest.fixture
def ready_once(machine):
    """As ``ready``, without a reset for each of many refusals."""
    machine.until(lambda: machine.states)
    if machine.state() != "motion":
        machine.to_cold()
        machine.to_motion()
        machine.until(lambda: machine.state() == "motion")
        assert machine.move(machine.home).success
    while now(machine) < 3.0:  # a trajectory of two seconds from the begin of time is one of the past
        assert machine.move(machine.home + STEP).success
        assert machine.move(machine.home).success
    return machine


GIVEN = ("positions", "velocities", "accelerations")
LIMITS = {"velocity": 0.8, "acceleration": 1.2}
"""Of left_rotation: the joint whose limits are the narrowest for the way below."""


def trapezoid(step, share=0.5, way=0.4):
    """Times ``step`` apart; the share of a way that a trapezoidal profile has covered, its two derivatives."""
    speed, force = share * LIMITS["velocity"] / way, share * LIMITS["acceleration"] / way
    ramp = speed / force
    end = 1.0 / speed + ramp
    t = np.append(np.arange(step, end - step / 2.0, step), end)
    rising, falling = np.minimum(t, ramp), np.minimum(end - t, ramp)
    covered = np.where(t < ramp, 0.5 * force * t**2, 0.5 * force * ramp**2 + speed * (t - ramp))
    covered = np.where(t > end - ramp, 1.0 - 0.5 * force * (end - t) ** 2, covered)
    change = np.where(t < ramp, force, np.where(t > end - ramp, -force, 0.0))
    return t, covered, force * np.minimum(rising, falling), change


WAY = 0.4 * np.ones(9) * [0.5, 1.0, 0.5, 1.0, -0.5, 0.5, 1.0, 1.0, 1.0]


def trapezoidal(client, step, many):
    """A goal along a way, beyond the limit of jerk, and the time that it asks for."""
    t, *rows = trapezoid(step)
    request = goal(client)
    for k, time in enumerate(t):
        point = JointTrajectoryPoint(time_from_start=duration(float(time)))
        for order, name in enumerate(GIVEN[:many]):
            setattr(point, name, list(map(float, (client.home if order == 0 else 0.0) + rows[order][k] * WAY)))
        request.trajectory.points.append(point)
    return request, float(t[-1])


@pytest.mark.parametrize(
    ("tolerances", "code"),
    [
        ({"goal_time_tolerance": duration(0.02)}, Result.GOAL_TOLERANCE_VIOLATED),
        ({"goal_time_tolerance": duration(2.0)}, Result.SUCCESSFUL),
        ({"path_tolerance": [JointTolerance(name="left_j1", position=5e-4)]}, Result.PATH_TOLERANCE_VIOLATED),
        ({"path_tolerance": [JointTolerance(name="left_j1", position=-1.0)]}, Result.SUCCESSFUL),
    ],
)
def test_what_is_retimed_is_held_against_its_message(ready, tolerances, code):
    request, asked_s = trapezoidal(ready, 0.1, 2)
    for name, value in tolerances.items():
        setattr(request, name, value)
    answer = ready.follow(request)[1]()
    assert answer.result.error_code == code, answer.result.error_string
    if code == Result.SUCCESSFUL:
        assert f"instead of {asked_s:.3f} s" in answer.result.error_string
    else:
        assert re.search(
            r"left_\w+: .*error -?[\d.e-]+ .* is beyond the (path|goal) tolerance", answer.result.error_string
        )


@pytest.mark.parametrize("rate_hz", [10, 30])
def test_a_client_that_plans_anew_is_followed_and_the_next_move_begins(ready, rate_hz):
    """In testbed time, which runs as fast as it can here: a busy computer leaves plans out, so each reaches far."""
    setpoints = ready.listen(GroupSetpoints, "/left/setpoints")
    began, size, ahead_s, results = now(ready), 0.2, 0.4, []
    while (passed := now(ready) - began) < 6.0:
        times = passed + ahead_s * np.arange(1, 11)
        shares, speeds = size * np.sin(times), size * np.cos(times)
        speeds[-1] = 0.0
        request = goal(ready, *((ahead_s * k, ready.home + share * WAY) for k, share in enumerate(shares, 1)))
        for point, velocity in zip(request.trajectory.points, speeds, strict=True):
            point.velocities = list(velocity * WAY)
        results.append(ready.follow(request)[1])
        ready.until(lambda passed=passed: now(ready) - began > passed + 1.0 / rate_hz)
    assert ready.move(ready.home, policy=Move.Goal.REPLACE).success
    answers = [result() for result in results]
    replaced = [answer for answer in answers if answer.status != SUCCEEDED]  # some may end while the computer is busy
    assert len(replaced) > len(answers) / 2
    for answer in replaced:
        assert (answer.status, answer.result.error_code) == (ABORTED, Result.INVALID_GOAL)
        assert "replaced by" in answer.result.error_string
    stamps = np.array([message.stamp.sec + 1e-9 * message.stamp.nanosec for message in setpoints]) - began
    place = (np.array([message.position for message in setpoints]) - ready.home) @ WAY / (WAY @ WAY)
    during = (stamps > 0.5) & (stamps < 6.0)
    assert during.any()
    assert place[during].max() > 0.8 * size
    assert place[during].min() < -0.4 * size


@pytest.mark.parametrize("many", [1, 2, 3])
@pytest.mark.parametrize("step", [0.1, 0.02])
def test_a_trapezoidal_profile_is_followed_on_its_path(ready, step, many):
    """Its acceleration jumps: it takes a little longer, says so, and is nowhere else."""
    request, asked_s = trapezoidal(ready, step, many)
    told = []
    answer = ready.follow(request, lambda message: told.append(message.feedback))[1]()
    assert answer.status == SUCCEEDED, answer.result.error_string
    assert f"instead of {asked_s:.3f} s, because of jerk of left_" in answer.result.error_string
    np.testing.assert_allclose(ready.rest(), ready.home + WAY, atol=1e-4)
    seen = np.array([feedback.desired.positions for feedback in told]) - ready.home
    share = seen @ WAY / (WAY @ WAY)
    assert np.abs(seen - share[:, None] * WAY).max() < 1e-4
    last = told[-1]
    assert 0.0 < last.desired.time_from_start.sec + 1e-9 * last.desired.time_from_start.nanosec <= asked_s + 1e-6
