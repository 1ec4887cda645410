"""Messages with trajectories, and what a group is asked to follow."""

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointComponentTolerance, JointTolerance
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_core.errors import DataError, ImError
from im_mcs.client.trajectory import Accepted, GoalTolerances, Present, TimedTrajectory, Tolerance, trajectory_path
from im_mcs.protocol.points import unpack_points
from im_mcs.ros.actions.trajectory_messages import goal_tolerances, timed_trajectory

JOINTS = ("a", "b", "c")
NUMBERS = st.floats(allow_nan=True, allow_infinity=True)
ARRAYS = ("positions", "velocities", "accelerations", "effort")


def span(kind, seconds):
    return kind(sec=math.floor(seconds), nanosec=min(round(1e9 * (seconds % 1.0)), 999_999_999))


def sent(*points, joints=JOINTS, start=0.0):
    """A trajectory through points, each of a time and arrays, as rclpy hands it over."""
    message = JointTrajectory(joint_names=list(joints))
    message.header.stamp = span(Time, start)
    for time, *arrays in points:
        point = JointTrajectoryPoint(time_from_start=span(Duration, time))
        for name, array in zip(ARRAYS, arrays, strict=False):
            setattr(point, name, list(map(float, array)))
        message.points.append(point)
    return deserialize_message(serialize_message(message), JointTrajectory)


@pytest.mark.parametrize("arrays", [1, 2, 3])
@pytest.mark.parametrize("joints", [["a"], ["a", "bc"], ["joint of seven"] * 7])
def test_points_are_read_as_they_were_written(arrays, joints):
    random = np.random.default_rng(arrays)
    points = [(k + 0.25, *random.normal(size=(arrays, len(joints)))) for k in range(5)]
    found = timed_trajectory(sent(*points, joints=joints, start=3.5))
    assert list(found.joints) == joints
    assert found.start_s == 3.5
    np.testing.assert_array_equal(found.times, [point[0] for point in points])
    for k, values in enumerate((found.q, found.v, found.a), start=1):
        if k <= arrays:
            np.testing.assert_array_equal(values, [point[k] for point in points])
        else:
            assert values is None


def test_points_without_velocities_among_others_get_some_that_swing_beyond_no_point():
    points = [(1.0, [1, 0, 0]), (2.0, [2, 1, 0]), (3.0, [5, 0, 0], [2, 0, 0]), (4.0, [6, 2, 0]), (5.0, [7, 3, 0])]
    found = timed_trajectory(sent(*points)).v
    np.testing.assert_allclose(found, [[1, 1, 0], [1.5, 0, 0], [2, 0, 0], [1, 4 / 3, 0], [0, 0, 0]])


def test_tolerances_are_read():
    goal = FollowJointTrajectory.Goal(goal_time_tolerance=span(Duration, 0.5))
    goal.path_tolerance = [JointTolerance(name="a", position=0.1, velocity=-1.0, acceleration=0.5)]
    goal.goal_tolerance = [JointTolerance(name="bcd", position=1.0, velocity=2.0, acceleration=3.0), JointTolerance()]
    path, end = [Tolerance("a", 0.1, -1.0, 0.5)], [Tolerance("bcd", 1.0, 2.0, 3.0), Tolerance("", 0.0, 0.0, 0.0)]
    assert goal_tolerances(goal) == GoalTolerances(path, end, 0.5)
    goal.path_tolerance = [JointTolerance(name="a")] * 1000
    with pytest.raises(DataError, match="path_tolerance has 1000 values, 64 are allowed"):
        goal_tolerances(goal)


@pytest.mark.parametrize("where", ["path", "goal"])
def test_tolerances_of_several_degrees_of_freedom_are_refused(where):
    goal = FollowJointTrajectory.Goal(**{f"component_{where}_tolerance": [JointComponentTolerance()]})
    with pytest.raises(DataError, match=f"component_{where}_tolerance is not empty"):
        goal_tolerances(goal)


@pytest.mark.parametrize(
    ("points", "sentence"),
    [
        ([(1.0, [1, 2])], "point 1: position is given for 2 joints, 3 are needed"),
        ([(1.0, [1, 2, 3]), (2.0, [])], "point 2: position is given for 0 joints, 3 are needed"),
        ([(1.0, [1, 2, 3]), (2.0, [1, 2, 3]), (3.0, [1, 2, 3, 4])], "point 3: position is given for 4 joints"),
        ([(1.0, [1, 2, 3], [1])], "point 1: velocity is given for 1 joints, 3 are needed"),
        ([(k, [1, 2, 3], [0, 0, 0], *([[1, 2, 3]] if k else [])) for k in range(9)], "point 1 has no accelerations"),
        ([(1.0, [1, 2, 3]), (2.0, [1, 2, 3], [1])], "point 2: velocity is given for 1 joints, 3 are needed"),
        ([(1.0, [1, 2, 3], [], [], [0.0] * 3)], "point 1 has efforts"),
    ],
)
def test_a_point_unlike_the_others_is_named(points, sentence):
    with pytest.raises(DataError, match=sentence):
        timed_trajectory(sent(*points))


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.sampled_from([*JOINTS, "d", ""]), max_size=4),
    st.lists(
        st.tuples(
            st.floats(-2.0, 5.0),
            st.lists(NUMBERS, max_size=4),
            st.lists(NUMBERS, max_size=4),
            st.lists(NUMBERS, max_size=4),
            st.lists(NUMBERS, max_size=1),
        ),
        max_size=4,
    ),
    st.floats(0.0, 20.0),
    st.lists(st.builds(Tolerance, st.sampled_from([*JOINTS, "d"]), NUMBERS, NUMBERS), max_size=3),
    st.floats(-1.0, 5.0),
    st.builds(Accepted, st.booleans(), st.booleans()),
)
def test_whatever_comes_is_refused_or_fit_to_travel(joints, points, start, tolerances, goal_time_s, accepted):
    try:
        read = timed_trajectory(sent(*points, joints=joints, start=start))
        given_ = GoalTolerances(tolerances, tolerances, goal_time_s)
        asked = TimedTrajectory(read.joints, read.times, read.q, read.v, read.a, read.start_s, given_)
        path = trajectory_path("arm", JOINTS, asked, Present(10.0, np.zeros(3), True), accepted)
    except ImError:
        return
    found = unpack_points(path["points"])
    assert (np.diff(found.times) > 0.0).all()
    assert found.times[0] >= 0.0
    for values in (found.q, found.v, found.a):
        assert values is None or (values.shape == (len(found.times), 3) and np.isfinite(values).all())
