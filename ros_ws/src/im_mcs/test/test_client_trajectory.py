"""Trajectories of clients, and what a group is asked to follow."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_core.errors import DataError
from im_mcs.client.points import JointsError, joint_order, ordered_points
from im_mcs.client.trajectory import (
    Accepted,
    GoalTolerances,
    OldStampError,
    Present,
    TimedTrajectory,
    Tolerance,
    trajectory_path,
)
from im_mcs.protocol.points import unpack_points

JOINTS = ("a", "b", "c")


def path(*points, joints=JOINTS, start=0.0, now=10.0, at_rest=None, accepted=Accepted(), stream=False, **tolerances):  # noqa: B008
    """The path of a request for points, each of a time, positions, and derivatives that all have; its points listed."""
    times, *rows = (np.array(column, dtype=np.float64) for column in zip(*points, strict=True))
    q, v, a = [*rows, None, None][:3]
    asked = TimedTrajectory(joints, times, q, v, a, start, GoalTolerances(**tolerances))
    present = Present(now, np.array([0.1, 0.2, 0.3] if at_rest is None else at_rest), at_rest is not None)
    found = trajectory_path("arm", JOINTS, asked, present, accepted, stream=stream)
    packed = unpack_points(found["points"])
    q, v, a = ([[]] * len(packed.times) if x is None else x.tolist() for x in (packed.q, packed.v, packed.a))
    names = ("time", "positions", "velocities", "accelerations")
    listed = [dict(zip(names, row, strict=True)) for row in zip(packed.times.tolist(), q, v, a, strict=True)]
    return {**found, "points": listed}


@given(st.permutations(JOINTS))
def test_any_order_of_joints_is_the_same_trajectory(joints):
    values = {"a": 1.0, "b": 2.0, "c": 3.0}
    given_ = [values[name] for name in joints]
    accepted = Accepted(end_velocity=True)
    (point,) = path((1.0, given_, given_), joints=joints, accepted=accepted)["points"]
    assert point["positions"] == point["velocities"] == [1.0, 2.0, 3.0]
    assert ordered_points("arm", JOINTS, joints, [given_]) == [[1.0, 2.0, 3.0]]


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


def test_joints_that_are_left_out_hold_where_that_is_accepted():
    points = [(1.0, [3, 1], [3, 1], [3, 1]), (2.0, [4, 2], [0, 0], [0, 0])]
    with pytest.raises(JointsError, match="lacks b; all 3 joints are needed"):
        path(*points, joints=["c", "a"])
    found = path(*points, joints=["c", "a"], accepted=Accepted(partial_joints=True))["points"]
    assert [p["positions"] for p in found] == [[1.0, 0.2, 3.0], [2.0, 0.2, 4.0]]
    assert found[0]["velocities"] == found[0]["accelerations"] == [1.0, 0.0, 3.0]
    with pytest.raises(JointsError, match="'d'"):
        path(*points, joints=["c", "d"], accepted=Accepted(partial_joints=True))


def test_a_velocity_at_the_end_is_refused_unless_it_is_accepted():
    moving = (1.0, [1, 2, 3], [0, 0.5, 0])
    with pytest.raises(DataError, match=r"b has velocity 0\.5 in its last point"):
        path(moving)
    assert path(moving, accepted=Accepted(end_velocity=True))["points"][0]["velocities"] == [0.0, 0.5, 0.0]
    assert "stream" not in path(moving, accepted=Accepted(end_velocity=True))


def test_what_ends_not_far_ahead_on_the_topic_is_a_window_of_a_stream():
    moving = (0.1, [1, 2, 3], [1, 0, 0])
    assert path(moving, stream=True)["stream"]
    assert path((0.1, [1, 2, 3]), stream=True)["stream"]
    two = path((0.1, [1, 2, 3]), (0.2, [2, 2, 3]), stream=True)
    assert two["stream"]
    assert two["start_ns"] == 0
    assert "stream" not in path((1.0, [1, 2, 3]), stream=True)
    assert "stream" not in path((0.1, [1, 2, 3]), stream=True, start=10.45)
    with pytest.raises(DataError, match="last point"):
        path((1.0, [1, 2, 3], [1, 0, 0]), stream=True)


def test_a_window_keeps_its_times_and_its_stamp_also_where_it_has_just_ended():
    points = [(t, [t, t, t], [1, 1, 1]) for t in (0.0, 0.1, 0.2)]
    found = path(*points, stream=True, start=9.9)
    assert [p["time"] for p in found["points"]] == [0.0, 0.1, 0.2]
    assert found["start_ns"] == 9_900_000_000
    assert path(*points, stream=True, start=9.72)["stream"]
    with pytest.raises(OldStampError, match=r"ends at 9.880 s, 0.120 s before now"):
        path(*points, stream=True, start=9.68)


def test_a_start_to_come_shifts_times_and_holds_an_arm_at_rest():
    points = [(1.0, [1, 2, 3]), (2.0, [2, 3, 4])]
    assert [p["time"] for p in path(*points, start=12.5)["points"]] == [3.5, 4.5]
    held = path(*points, start=12.5, at_rest=[0.0, 0.0, 0.0])["points"]
    assert [p["time"] for p in held] == [2.5, 3.5, 4.5]
    assert held[0]["positions"] == [0.0, 0.0, 0.0]
    assert held[0]["velocities"] == []
    with_velocities = [(1.0, [1, 2, 3], [0, 0, 0])]
    assert path(*with_velocities, start=12.5, at_rest=[0.0] * 3)["points"][0]["velocities"] == [0.0] * 3


def test_of_a_trajectory_that_has_begun_the_rest_is_followed():
    points = [(t, [t, t, t]) for t in (0.0, 1.0, 2.0, 3.0)]
    rest = path(*points, start=8.5)["points"]
    assert [p["time"] for p in rest] == [0.5, 1.5]
    assert [p["positions"][0] for p in rest] == [2.0, 3.0]
    with pytest.raises(OldStampError, match=r"ends at 9.500 s, 0.500 s before now \(10.000 s\)"):
        path(*points, start=6.5)
    with pytest.raises(DataError, match=r"begins 1.7e\+09 s from now \(testbed time 10.000 s\).*of another clock"):
        path(*points, start=1.7e9)


def test_tolerances_by_name():
    arguments = path((1.0, [1, 2, 3]), path=[Tolerance("c", 0.1), Tolerance("a", -1.0)], goal_time_s=0.5)
    assert arguments["path_tolerance"] == [-1.0, 0.0, 0.1]
    assert arguments["path_velocity_tolerance"] == [0.0, 0.0, 0.0]
    assert arguments["goal_tolerance"] == arguments["goal_velocity_tolerance"] == []
    arguments = path((1.0, [1, 2, 3]), goal=[Tolerance("b", 0.0, velocity=0.2)], goal_time_s=0.5)
    assert arguments["goal_velocity_tolerance"] == [0.0, 0.2, 0.0]
    assert arguments["goal_time_tolerance"] == 0.5
    for wrong, sentence in (
        (Tolerance("c", -0.5), "path_tolerance of c: position -0.5 is neither"),
        (Tolerance("c", 0.1, velocity=-2.0), "path_tolerance of c: velocity -2 is neither"),
        (Tolerance("c", 0.1, acceleration=1.0), "of c: accelerations are not measured and cannot have a bound"),
        (Tolerance("c", 0.1, acceleration=math.nan), "acceleration nan is neither"),
    ):
        with pytest.raises(DataError, match=sentence):
            path((1.0, [1, 2, 3]), path=[wrong])
