"""Where a wrist must be for its tool to be where it is asked to be."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_coordinators.tool import ANY_TILT, ToolTarget, WristPlacement, require_planned, require_position
from im_core.errors import DataError, ImError

REACH = 0.15
HALF = math.sqrt(0.5)

angles = st.floats(-3.0, 3.0)
triples = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
quaternions = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .filter(lambda q: math.hypot(*q) > 0.1)
    .map(lambda q: [each / math.hypot(*q) for each in q])
)


def asked(position, orientation=(), frame="world"):
    request = {"group": "left", "position": list(position), "orientation": list(orientation), "frame": frame}
    return ToolTarget.asked(request)


def matrix(rotation, position):
    """A homogeneous transformation."""
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = rotation, position
    return whole


def turned(axis, angle):
    """A rotation about an axis of the frame."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.eye(3)
    rotation[i, i], rotation[i, j], rotation[j, i], rotation[j, j] = c, -s, s, c
    return rotation


def of_quaternion(q):
    """The rotation of a unit quaternion x, y, z, w, by the textbook."""
    x, y, z, w = q
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * skew + 2 * skew @ skew


def tool(wrist):
    """The transformation world <- tool for a wrist."""
    return matrix(of_quaternion(wrist.quaternion), wrist.position) @ matrix(np.eye(3), [0, 0, REACH])


@given(triples, st.tuples(angles, angles, angles), triples, quaternions)
def test_in_the_world_the_tool_comes_where_it_is_asked_to_be_by_roll_pitch_and_yaw(at, rpy, place, q):
    got = tool(asked(at, rpy).wrist(WristPlacement.of(place, q), REACH))
    roll, pitch, yaw = rpy
    assert got == pytest.approx(matrix(turned(2, yaw) @ turned(1, pitch) @ turned(0, roll), at), abs=1e-9)


@given(triples, quaternions, triples, quaternions)
def test_a_quaternion_says_the_same(at, orientation, place, q):
    got = tool(asked(at, orientation).wrist(WristPlacement.of(place, q), REACH))
    assert got == pytest.approx(matrix(of_quaternion(orientation), at), abs=1e-6)


@given(triples, quaternions, triples, quaternions)
def test_in_the_frame_of_the_tool_what_is_asked_comes_on_top_of_where_it_is(step, orientation, place, q):
    here = WristPlacement.of(place, q)
    got = tool(asked(step, orientation, "tool").wrist(here, REACH))
    assert got == pytest.approx(tool(here) @ matrix(of_quaternion(orientation), step), abs=1e-6)


@given(triples, triples, quaternions, st.sampled_from(["world", "tool"]))
def test_without_an_orientation_it_stays_as_it_is(at, place, q, frame):
    here = WristPlacement.of(place, q)
    got = tool(asked(at, frame=frame).wrist(here, REACH))
    assert got[:3, :3] == pytest.approx(tool(here)[:3, :3], abs=1e-9)
    expected = np.array(at) if frame == "world" else (tool(here) @ [*at, 1.0])[:3]
    assert got[:3, 3] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("position", "orientation", "told"),
    [
        ([], [], r"argument position has 0 numbers; x y z \[m\] are needed"),
        ([1.0, 2.0], [], "argument position has 2 numbers"),
        ([1, 2, 3], [1.0], r"argument orientation is \[1.0\]; roll pitch yaw"),
        ([1, 2, 3], [0, 0, 0, 2], "a quaternion x y z w of norm 1 are needed"),
        ([1, 2, 3], [0, 0, 0, 0], "a quaternion x y z w of norm 1 are needed"),
    ],
)
def test_what_is_no_pose_is_refused(position, orientation, told):
    with pytest.raises(DataError, match=told):
        asked(position, orientation)


@given(triples, st.none() | quaternions, triples, quaternions, st.sampled_from(["world", "tool"]))
def test_places_of_a_region_are_in_its_box_turned_by_no_more_than_the_yaw_and_the_nearest_comes_first(
    at, orientation, place, q, frame
):
    here, edges, yaw = WristPlacement.of(place, q), (0.4, 0.0, 0.2), 0.7
    target = replace(asked(at, orientation or (), frame), region=edges, yaw=yaw)
    axes = tool(here)[:3, :3] if frame == "tool" else np.eye(3)
    middle = tool(target.wrist(here, REACH))
    places = [tool(wrist) for wrist in target.wrists(here, REACH)]
    offsets = [axes.T @ (each[:3, 3] - middle[:3, 3]) for each in places]
    for each, offset in zip(places, offsets, strict=True):
        assert (np.abs(offset) <= np.array(edges) / 2 + 1e-9).all()
        turn = axes.T @ each[:3, :3] @ middle[:3, :3].T @ axes
        assert turn[2, 2] == pytest.approx(1.0, abs=1e-6), "about the z axis alone"
        assert abs(math.atan2(turn[1, 0], turn[0, 0])) <= yaw + 1e-6
    ways = [np.linalg.norm(each[:3, 3] - tool(here)[:3, 3]) for each in places]
    assert ways[0] <= min(ways) + 1e-9
    turns = [np.trace(each[:3, :3].T @ tool(here)[:3, :3]) for each in places]
    assert turns[0] >= max(turns) - 1e-6
    assert len({tuple(offset.round(9)) for offset in offsets}) >= len(places) - 1, (
        "but that the nearest may be the middle"
    )
    again = [tool(wrist) for wrist in target.wrists(here, REACH)]
    assert np.array_equal(again, places)


@given(triples, quaternions, triples, quaternions)
def test_without_a_region_there_is_one_place(at, orientation, place, q):
    target, here = asked(at, orientation), WristPlacement.of(place, q)
    (only,) = target.wrists(here, REACH)
    assert tool(only) == pytest.approx(tool(target.wrist(here, REACH)))


def test_a_region_has_three_edges_and_is_told_in_a_refusal():
    request = {"group": "left", "position": [1, 2, 3], "orientation": [], "frame": "world", "yaw": 0.5}
    target = ToolTarget.asked({**request, "region": [0.1, 0.2, 0.0]})
    assert (target.region, target.yaw) == ((0.1, 0.2, 0.0), 0.5)
    told = target.refusal(ImError("left_wrist is out of reach", code="unreachable")).message
    assert "at (1, 2, 3) m in world, nor at any place tried in the 0.1 x 0.2 x 0 m around it: left_wrist is" in told
    with pytest.raises(DataError, match="argument region has 2 numbers; the edges of a box along x y z"):
        ToolTarget.asked({**request, "region": [0.1, 0.2]})


def test_a_region_and_a_tilt_go_with_a_path_that_is_planned():
    require_planned({"region": [], "yaw": 0.0, "tilt": ANY_TILT}, "straight")
    for asked_for in ({"region": [0.1, 0.1, 0.1]}, {"yaw": 0.1}, {"tilt": 0.1}):
        (name,) = asked_for
        told = f"argument {name} goes with a path that is planned; it was given with straight"
        with pytest.raises(DataError, match=told):
            require_planned({"region": [], "yaw": 0.0, "tilt": ANY_TILT, **asked_for}, "straight")


def test_a_refusal_says_what_was_asked_and_keeps_its_code():
    why = ImError("left_wrist is out of reach", code="unreachable", frame="left_wrist")
    told = asked([0.0, 0.0, 9.0]).refusal(why)
    assert told.message == "the tool of left cannot be at (0, 0, 9) m in world: left_wrist is out of reach"
    assert (told.code, told.facts["position"]) == ("unreachable", [0.0, 0.0, 9.0])
    assert "in the frame of the tool as it is:" in asked([0, 0, 9], frame="tool").refusal(why).message


def test_orientation_and_frame_go_with_a_position():
    without = {"orientation": [], "frame": "world", "region": [], "yaw": 0.0}
    require_position(without, "joints")
    require_position({**without, "orientation": [0.0, 0.0, HALF, HALF], "frame": "tool", "yaw": 0.1}, "position")
    with pytest.raises(DataError, match="argument orientation goes with position; it was given with joints"):
        require_position({**without, "orientation": [0.0, 0.0, 1.0]}, "joints")
    with pytest.raises(DataError, match="argument frame goes with position; it was given with destination"):
        require_position({**without, "frame": "tool"}, "destination")
    with pytest.raises(DataError, match="argument region goes with position; it was given with posture"):
        require_position({**without, "region": [0.1, 0.1, 0.1]}, "posture")
