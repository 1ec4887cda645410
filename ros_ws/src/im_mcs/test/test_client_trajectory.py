"""Trajectories of clients: from the bytes that travel to what a group is asked to follow."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import DataError, ImError
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
from im_mcs.client.wire import CdrReader, read_head, read_tolerances, read_trajectory

JOINTS = ("a", "b", "c")
NUMBERS = st.floats(allow_nan=True, allow_infinity=True)


class Cdr:
    """Writes CDR, as the specification of DDS has it."""

    def __init__(self, order="<"):
        self.order, self.data = order, bytearray({"<": b"\0\1\0\0", ">": b"\0\0\0\0"}[order])

    def put(self, kind, *values):
        self.data += bytes(-(len(self.data) - 4) % struct.calcsize(kind))
        self.data += struct.pack(f"{self.order}{len(values)}{kind}", *values)

    def text(self, text):
        data = text.encode() + b"\0"
        self.put("I", len(data))
        self.data += data

    def time(self, seconds):
        self.put("i", math.floor(seconds))
        self.put("I", round(1e9 * (seconds - math.floor(seconds))))

    def tolerances(self, tolerances):
        self.put("I", len(tolerances))
        for tolerance in tolerances:
            self.text(tolerance.joint)
            self.put("d", tolerance.position, tolerance.velocity, tolerance.acceleration)

    def header(self, joints, start=0.0):
        self.time(start)
        self.text("base")
        self.put("I", len(joints))
        for joint in joints:
            self.text(joint)

    def trajectory(self, joints, points, start=0.0):
        self.header(joints, start)
        self.put("I", len(points))
        for time, *arrays in points:
            for array in [*arrays, [], [], []][:4]:
                self.put("I", len(array))
                if len(array):
                    self.put("d", *array)
            self.time(time)

    def goal(self, joints, points, start=0.0, path=(), goal=(), goal_time=0.0):
        self.trajectory(joints, points, start)
        self.header(())
        self.put("I", 0)
        for tolerances in (path, goal):
            self.tolerances(tolerances)
            self.put("I", 0)
        self.time(goal_time)


def read(data, most=1000):
    cdr = CdrReader(bytes(data))
    return read_trajectory(cdr, read_head(cdr, most))


def trajectory(*points, joints=JOINTS, start=0.0, order="<"):
    cdr = Cdr(order)
    cdr.trajectory(joints, points, start)
    return read(cdr.data)


def path(*points, joints=JOINTS, start=0.0, now=10.0, at_rest=None, accepted=Accepted(), stream=False, **tolerances):  # noqa: B008
    asked = trajectory(*points, joints=joints, start=start)
    asked = TimedTrajectory(asked.joints, asked.times, asked.q, asked.v, asked.a, start, GoalTolerances(**tolerances))
    present = Present(now, np.array([0.1, 0.2, 0.3] if at_rest is None else at_rest), at_rest is not None)
    course, rest = trajectory_path("arm", JOINTS, asked, present, accepted, stream=stream)
    return {**rest, "points": course.points()}


# bytes


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("arrays", [1, 2, 3])
@pytest.mark.parametrize("joints", [["a"], ["a", "bc"], ["joint of seven"] * 7])
def test_points_are_read_as_they_were_written(order, arrays, joints):
    random = np.random.default_rng(arrays)
    points = [(k + 0.25, *random.normal(size=(arrays, len(joints)))) for k in range(5)]
    found = trajectory(*points, joints=joints, order=order, start=3.5)
    assert found.joints == joints
    assert found.start_s == 3.5
    np.testing.assert_array_equal(found.times, [point[0] for point in points])
    for k, values in enumerate((found.q, found.v, found.a), start=1):
        if k <= arrays:
            np.testing.assert_array_equal(values, [point[k] for point in points])
        else:
            assert values is None


def test_tolerances_are_read_behind_the_points():
    cdr = Cdr()
    path_, goal = [Tolerance("a", 0.1, -1.0, 0.5)], [Tolerance("bcd", 1.0, 2.0, 3.0), Tolerance("", 0.0, 0.0, 0.0)]
    cdr.goal(JOINTS, [(1.0, [1, 2, 3])], path=path_, goal=goal, goal_time=0.5)
    reader = CdrReader(bytes(cdr.data))
    read_trajectory(reader, read_head(reader, 10))
    assert read_tolerances(reader) == GoalTolerances(path_, goal, 0.5)
    assert reader.at == len(cdr.data)


@pytest.mark.parametrize(
    ("points", "sentence"),
    [
        ([(1.0, [1, 2])], "point 1: position is given for 2 joints, 3 are needed"),
        ([(1.0, [1, 2, 3]), (2.0, [])], "point 2: position is given for 0 joints, 3 are needed"),
        ([(1.0, [1, 2, 3]), (2.0, [1, 2, 3]), (3.0, [1, 2, 3, 4])], "point 3: position is given for 4 joints"),
        ([(1.0, [1, 2, 3], [1])], "point 1: velocity is given for 1 joints, 3 are needed"),
        ([(k, [1, 2, 3], *([[1, 2, 3]] if k != 7 else [])) for k in range(9)], "point 8 has no velocities, others"),
        ([(k, [1, 2, 3], *([[1, 2, 3]] if k == 7 else [])) for k in range(9)], "point 8 has velocities, point 1 has"),
        ([(1.0, [1, 2, 3], [], [], [0.0] * 3)], "point 1 has efforts"),
    ],
)
def test_a_point_unlike_the_first_is_named(points, sentence):
    with pytest.raises(DataError, match=sentence):
        trajectory(*points)


def test_what_is_too_long_is_refused_by_the_begin_of_its_bytes():
    cdr = Cdr()
    cdr.header(JOINTS)
    cdr.put("I", 1_000_000)  # the points themselves need not have come
    with pytest.raises(DataError, match="a trajectory of 1000000 points is too long; 100000 are allowed"):
        read_head(CdrReader(bytes(cdr.data)), 100_000)
    with pytest.raises(DataError, match="too few for 1000000 points"):
        read_head(CdrReader(bytes(cdr.data)), 10**7)
    for joints, sentence in (
        (["a" * 1_000_000], "a name of 1000000 bytes is too long; 256 are allowed"),
        (["a"] * 300_000, "joint_names has 300000 entries; 100 are allowed"),
    ):
        cdr = Cdr()
        cdr.header(joints)
        with pytest.raises(DataError, match=sentence) as refused:
            read_head(CdrReader(bytes(cdr.data)), 100_000)
        assert len(refused.value.message) < 100


def test_a_hundred_thousand_points_are_read_without_looking_at_each(monkeypatch):
    few = {}
    for count in (2, 3):
        few[count] = Cdr()
        few[count].trajectory(JOINTS, [(0.0, [1, 2, 3], [4, 5, 6])] * count)
    head = Cdr()
    head.header(JOINTS)
    head.put("I", 100_000)
    size = len(few[3].data) - len(few[2].data)
    data = head.data + few[3].data[len(head.data) :] + few[3].data[-size:] * 99_997
    looked = []
    monkeypatch.setattr(CdrReader, "doubles", _counted(CdrReader.doubles, looked))
    found = read(data, 100_000)
    assert found.q.shape == found.v.shape == (100_000, 3)
    assert (found.q == [1, 2, 3]).all()
    assert (found.v == [4, 5, 6]).all()
    assert len(looked) < 20


def _counted(function, calls):
    def counted(*arguments):
        calls.append(arguments)
        return function(*arguments)

    return counted


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_whatever_bytes_come_are_refused_with_a_sentence_or_read(data):
    cdr = Cdr()
    cdr.goal(JOINTS, [(1.0, [1, 2, 3], [1, 2, 3]), (2.0, [1, 2, 3], [0, 0, 0])], path=[Tolerance("a", 1.0)])
    whole = bytearray(cdr.data[: data.draw(st.integers(0, len(cdr.data)))])
    for at in data.draw(st.lists(st.integers(0, max(len(whole) - 1, 0)), max_size=4)):
        if whole:
            whole[at] = data.draw(st.integers(0, 255))
    try:
        reader = CdrReader(bytes(whole))
        found = read_trajectory(reader, read_head(reader, 1000))
        read_tolerances(reader)
    except DataError:
        return
    assert found.q.shape == (len(found.times), len(found.joints))


# what is followed


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
    assert not path(moving, accepted=Accepted(end_velocity=True))["may_be_late"]


def test_a_point_alone_on_the_topic_and_not_far_ahead_is_a_setpoint_of_a_stream():
    assert path((0.1, [1, 2, 3], [1, 0, 0]), stream=True)["may_be_late"]
    assert path((0.1, [1, 2, 3]), stream=True)["may_be_late"]
    assert not path((1.0, [1, 2, 3]), stream=True)["may_be_late"]
    assert not path((0.1, [1, 2, 3]), (0.2, [1, 2, 3]), stream=True)["may_be_late"]
    with pytest.raises(DataError, match="last point"):
        path((1.0, [1, 2, 3], [1, 0, 0]), stream=True)


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
    given_ = {"path": tolerances, "goal": tolerances, "goal_time_s": goal_time_s}
    try:
        arguments = path(*points, joints=joints, start=start, at_rest=[0.0] * 3, accepted=accepted, **given_)
    except ImError:
        return
    times = [point["time"] for point in arguments["points"]]
    assert times == sorted(set(times))
    assert times[0] >= 0.0
    for point in arguments["points"]:
        for name in ("positions", "velocities", "accelerations"):
            assert all(map(math.isfinite, point[name]))
            assert len(point[name]) in ((3,) if name == "positions" else (0, 3))
