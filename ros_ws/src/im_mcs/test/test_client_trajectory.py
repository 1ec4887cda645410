"""Trajectories of clients, as arguments of a MOVE request."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import DataError, ImError
from im_mcs.client.points import JointsError, joint_order, ordered_points
from im_mcs.client.trajectory import (
    GoalTolerances,
    OldStampError,
    TimedTrajectory,
    Tolerance,
    Waypoint,
    trajectory_path,
)

JOINTS = ("a", "b", "c")
NUMBERS = st.floats(allow_nan=True, allow_infinity=True)


def path(*points, joints=JOINTS, start_s=0.0, now_s=10.0, at_rest=None, **tolerances):
    given_ = TimedTrajectory(joints, points, start_s, GoalTolerances(**tolerances))
    return trajectory_path("arm", JOINTS, given_, now_s, at_rest)


@given(st.permutations(JOINTS))
def test_any_order_of_joints_is_the_same_trajectory(names):
    values = {"a": 1.0, "b": 2.0, "c": 3.0}
    given_ = [values[name] for name in names]
    (point,) = path(Waypoint(1.0, given_, given_), joints=names)["points"]
    assert point["positions"] == point["velocities"] == [1.0, 2.0, 3.0]
    assert ordered_points("arm", JOINTS, names, [given_]) == [[1.0, 2.0, 3.0]]


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        (["a", "b"], "lacks c; all 3 joints are needed"),
        (["a", "b", "c", "d"], "there is no joint of group 'arm' 'd'"),
        (["a", "b", "c", "b"], "'b' is given 2 times"),
    ],
)
def test_joints_that_are_not_the_groups_are_named(names, sentence):
    with pytest.raises(JointsError, match=sentence):
        joint_order("arm", JOINTS, names)


def test_a_start_to_come_shifts_times_and_holds_an_arm_at_rest():
    points = [Waypoint(1.0, [1, 2, 3]), Waypoint(2.0, [2, 3, 4])]
    assert [p["time"] for p in path(*points, start_s=12.5)["points"]] == [3.5, 4.5]
    held = path(*points, start_s=12.5, at_rest=[0.0, 0.0, 0.0])["points"]
    assert [p["time"] for p in held] == [2.5, 3.5, 4.5]
    assert held[0]["positions"] == [0.0, 0.0, 0.0]
    assert held[0]["velocities"] == []
    with_velocities = [Waypoint(1.0, [1, 2, 3], [0, 0, 0])]
    assert path(*with_velocities, start_s=12.5, at_rest=[0.0] * 3)["points"][0]["velocities"] == [0.0] * 3


def test_of_a_trajectory_that_has_begun_the_rest_is_followed():
    points = [Waypoint(t, [t, t, t]) for t in (0.0, 1.0, 2.0, 3.0)]
    rest = path(*points, start_s=8.5)["points"]
    assert [p["time"] for p in rest] == [0.5, 1.5]
    assert [p["positions"][0] for p in rest] == [2.0, 3.0]
    with pytest.raises(OldStampError, match=r"ends at 9.500 s, 0.500 s before now \(10.000 s\)"):
        path(*points, start_s=6.5)


def test_tolerances_by_name():
    arguments = path(Waypoint(1.0, [1, 2, 3]), path=[Tolerance("c", 0.1), Tolerance("a", -1.0)], goal_time_s=0.5)
    assert arguments["path_tolerance"] == [-1.0, 0.0, 0.1]
    assert arguments["path_velocity_tolerance"] == [0.0, 0.0, 0.0]
    assert arguments["goal_tolerance"] == arguments["goal_velocity_tolerance"] == []
    arguments = path(Waypoint(1.0, [1, 2, 3]), goal=[Tolerance("b", 0.0, velocity=0.2)], goal_time_s=0.5)
    assert arguments["goal_velocity_tolerance"] == [0.0, 0.2, 0.0]
    assert arguments["goal_time_tolerance"] == 0.5
    for wrong, sentence in (
        (Tolerance("c", -0.5), "path_tolerance of c: position -0.5 is neither"),
        (Tolerance("c", 0.1, velocity=-2.0), "path_tolerance of c: velocity -2 is neither"),
        (Tolerance("c", 0.1, acceleration=1.0), "of c: accelerations are not measured and cannot have a bound"),
        (Tolerance("c", 0.1, acceleration=math.nan), "acceleration nan is neither"),
    ):
        with pytest.raises(DataError, match=sentence):
            path(Waypoint(1.0, [1, 2, 3]), path=[wrong])


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.sampled_from([*JOINTS, "d", ""]), max_size=4),
    st.lists(
        st.builds(
            Waypoint,
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
)
def test_whatever_comes_is_refused_or_fit_to_travel(joints, points, start_s, tolerances, goal_time_s):
    trajectory = TimedTrajectory(joints, points, start_s, GoalTolerances(tolerances, tolerances, goal_time_s))
    try:
        arguments = trajectory_path("arm", JOINTS, trajectory, 10.0, [0.0] * 3)
    except ImError:
        return
    times = [point["time"] for point in arguments["points"]]
    assert times == sorted(set(times))
    assert times[0] >= 0.0
    for point in arguments["points"]:
        for name in ("positions", "velocities", "accelerations"):
            assert all(map(math.isfinite, point[name]))
            assert len(point[name]) in ((3,) if name == "positions" else (0, 3))
