"""Every wrong argument of a path is refused with a sentence, and nothing moves."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import DataError, ImError, LimitError

POSE = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
HOME = [-0.6, 0.0, 0.0, 0.0, 1.75, -3.3, 0.0, 0.0, 0.0]
NOT_COLUMNS = "is not times, positions, velocities, accelerations, each doubles as bytes"


def point(time=2.0, positions=None, **more):
    return {"time": time, "positions": positions or [0.0] * 9, **more}


def course(*points, **more):
    return {"kind": "trajectory", "points": list(points), **more}


def columns(times=(1.0,), positions=HOME, velocities=(), accelerations=(), **more):
    """A trajectory from the numbers of each column, in a row."""
    given = {"times": times, "positions": positions, "velocities": velocities, "accelerations": accelerations}
    return {"kind": "trajectory", "points": {name: column(numbers) for name, numbers in given.items()} | more}


def column(numbers):
    return np.array(numbers, dtype="<f8").tobytes()


def line(*poses, **more):
    return {"kind": "line", "poses": list(poses), **more}


@pytest.mark.parametrize(
    ("path", "sentence"),
    [
        (None, "a path is an object with a kind, not None"),
        ({}, "kind None is not one of joint, line, trajectory"),
        ({"kind": "spiral"}, "kind 'spiral' is not one of joint, line, trajectory"),
        ({"kind": "joint"}, "points is missing; it takes kind, points, [blend]"),
        ({"kind": "joint", "points": [HOME], "speed": 1.0}, "unknown speed; it takes kind, points, [blend]"),
        ({"kind": "joint", "points": []}, "0 points"),
        ({"kind": "joint", "points": [HOME] * 201}, "201 points is not one of 1 to 200"),
        ({"kind": "joint", "points": 7}, "points: 7 is not a list"),
        ({"kind": "joint", "points": [HOME, 3]}, "point 2: 3 is not a list"),
        ({"kind": "joint", "points": [[*HOME[:8], "x"]]}, "point 1: 'x' is not a number"),
        ({"kind": "joint", "points": [HOME[:8]]}, "point 1: 8 positions for 9 joints"),
        ({"kind": "joint", "points": [[*HOME[:8], math.inf]]}, "left_j6: position inf is not a finite number"),
        ({"kind": "joint", "points": [[*HOME[:8], 9.0]]}, "left_j6: position of point 1 9 rad is beyond the limit"),
        ({"kind": "joint", "points": [HOME], "blend": -0.1}, "blend -0.1 is not a finite number >= 0"),
        ({"kind": "joint", "points": [HOME], "blend": math.nan}, "blend nan is not a finite number >= 0"),
        (course(), f"points: [] {NOT_COLUMNS}"),
        (course(3), f"points: [3] {NOT_COLUMNS}"),
        (course() | {"points": 7}, f"points: 7 {NOT_COLUMNS}"),
        (columns(effort=b""), NOT_COLUMNS),
        (columns(positions=HOME[:8], times=[1.0, 2.0, 3.0]), NOT_COLUMNS),
        (columns(velocities=HOME, times=[1.0, 2.0], positions=2 * HOME), NOT_COLUMNS),
        (columns(times=[]), NOT_COLUMNS),
        *(
            (course() | {"points": {**columns()["points"], "times": wrong}}, NOT_COLUMNS)
            for wrong in ("3", "xy", "00", 7)
        ),
        (columns(times=[], positions=[]), "a trajectory of 0 points is not one of 1 to 5000"),
        (columns(np.arange(5001.0), 5001 * HOME), "a trajectory of 5001 points is not one of 1 to 5000"),
        (columns(positions=[]), "point 1: 0 positions for 9 joints"),
        (course(point(1.0, HOME[:8])), "point 1: 8 positions for 9 joints"),
        (course(point(1.0, [*HOME[:8], math.nan])), "left_j6: position nan is not a finite number"),
        (course(point(-1.0, HOME)), "times from -1 to -1 s are not within 0 to 1e+06 s"),
        (course(point(-1.0, HOME), point(1.0, HOME)), "times from -1 to 1 s are not within 0 to 1e+06 s"),
        (course(point(1.0, HOME), point(1e9, HOME)), "times from 1 to 1e+09 s are not within 0 to 1e+06 s"),
        (course(point(math.nan, HOME)), "times from nan to nan s are not"),
        (course(point(1.0, HOME), point(math.nan, HOME)), "point 2 is at nan s, not after point 1 at 1 s"),
        (course(point(2.0, HOME), point(2.0, HOME)), "point 2 is at 2 s, not after point 1 at 2 s"),
        (course(point(2.0, HOME, velocities=[0.0])), "point 1: velocities: 1 values for 9 joints"),
        (course(point(2.0, HOME, velocities=[math.nan] * 9)), "left_track: nan is not a finite number"),
        (course(point(2.0, HOME), stream=True, start_ns=-1), "start_ns -1 is not a whole number >= 0 [ns]"),
        (course(point(2.0, HOME, accelerations=[0.0] * 9)), "accelerations but no velocities"),
        (course(point(2.0, HOME), path_tolerance=[0.1]), "path_tolerance: 1 values for 9 joints"),
        (course(point(2.0, HOME), goal_velocity_tolerance=[math.nan] * 9), "left_track: nan is not a finite number"),
        (line(), "a line through 0 poses is not one of 1 to 200"),
        (line([0.0] * 6), "pose 1 of the line: the pose has 6 values, not 7"),
        (line(POSE, [1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]), "pose 2 of the line: the orientation (0, 0, 0, 0) is not a"),
        (line([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.1]), "is not a unit quaternion: its length is 1.1"),
        (line([math.nan, *POSE[1:]]), "pose 1 of the line: the pose [nan, "),
        (line("here"), "pose 1 of the line: the pose: 'here' is not a list"),
        (line(POSE, speed=-1.0), "speed -1.0 is not a finite number >= 0 [m/s]"),
        (line(POSE, blend=math.inf), "blend inf is not a finite number >= 0 [m]"),
        (course(point(2.0, HOME), goal_time_tolerance=-1), "goal_time_tolerance -1 is not a finite number >= 0 [s]"),
    ],
)
def test_wrong_paths_are_refused_with_a_sentence(rig, path, sentence):
    with pytest.raises(ImError) as refused:
        rig.request(path)
    assert sentence in refused.value.message
    assert rig.group.goals == ()
    assert not rig.group.moving


def test_a_velocity_beyond_its_limit_is_refused_at_once_where_nothing_may_be_re_timed(make_rig, refusing):
    rig = make_rig(planning=refusing)
    with pytest.raises(LimitError, match="left_track: velocity of point 1 5 m/s is beyond the limit"):
        rig.request(course(point(2.0, HOME, velocities=[5.0] * 9), point(4.0, HOME, velocities=[0.0] * 9)))
    assert not rig.group.moving


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"policy": "ignore"}, "policy 'ignore' is not one of refuse, append, replace"),
        ({"speed_scale": 2}, "speed_scale 2 is not between 0.01 and 1 .0 stands for 1."),
        ({"speed_scale": 1e-3}, "speed_scale 0.001 is not between 0.01 and 1"),
        ({"speed_scale": math.nan}, "speed_scale nan is not between"),
    ],
)
def test_wrong_policies_and_scales_are_refused(rig, arguments, sentence):
    with pytest.raises(DataError, match=sentence):
        rig.move(rig.home, **arguments)


values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
numbers = st.lists(st.floats(), min_size=8, max_size=10)
texts = st.lists(st.floats(), max_size=9).map(column)
paths = st.fixed_dictionaries(
    {"kind": st.sampled_from(["joint", "line", "trajectory"]) | values},
    optional={
        "points": st.lists(numbers | values, max_size=3)
        | st.fixed_dictionaries(dict.fromkeys(("times", "positions", "velocities", "accelerations"), texts | values))
        | st.builds(
            lambda times, *rows: columns(times, *(row * len(times) for row in rows))["points"],
            st.lists(st.floats(), max_size=3),
            numbers,
            st.just([]) | numbers,
            st.just([]) | numbers,
        )
        | values,
        "poses": st.lists(st.lists(st.floats(), min_size=6, max_size=8) | values, max_size=3) | values,
        "speed": values,
        "blend": values,
        "path_tolerance": numbers | values,
        "goal_time_tolerance": values,
    },
)


@settings(max_examples=200, deadline=None)
@given(values | paths)
def test_no_path_whatever_breaks_the_loop(make_rig, path):
    rig = make_rig()
    try:
        rig.request(path)
    except ImError:
        assert rig.group.goals == ()
    rig.ticks(20)
    assert np.isfinite(rig.trace[-1].q).all()
    rig.check_motion()
