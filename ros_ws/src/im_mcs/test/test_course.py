"""Courses for a robot that follows trajectories by itself: what they say is what the setpoints then do."""

import numpy as np
import pinocchio as pin
import pytest
import yaml

from im_mcs.limits.configuration import load_config
from im_mcs.protocol.points import TimedPoints, pack_points
from support.mcs_config import mcs_text

LEFT = slice(0, 9)
REFUSED = "trajectory controller cannot follow: the end of this motion is not known beforehand"


@pytest.fixture
def followed(tmp_path, make_bench, monkeypatch):
    """A bench whose driver takes positions and follows courses; ``courses``: each with the tick that it counts from."""
    data = yaml.safe_load(mcs_text())
    loopback = {"driver": "im_mcs.testbed.loopback:LoopbackDriver", "settings": {"inertia": [1.0], "q": [0.0]}}
    data["testbed"]["drivers"]["testbed"] = loopback
    for slot in data["slots"]:
        if slot.get("kind", "joint") == "joint":
            slot["interface"] = "position"
    data["control"] = {"controller": "im_mcs.control.setpoints:SetpointPosition"}
    path = tmp_path / "mcs.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    monkeypatch.setattr("im_mcs.testbed.loopback.LoopbackDriver.follow", lambda driver, course: None, raising=False)
    monkeypatch.setattr("im_mcs.testbed.loopback.LoopbackDriver.speed", 1.0, raising=False)
    bench = make_bench(load_config(path))
    bench.courses = []
    bench.driver.follow = lambda course: bench.courses.append((bench.mcs.measured.tick, course))
    bench.setpoints = {}
    bench.to_motion("left")
    return bench


def run(bench, ticks):
    for _ in range(ticks):
        bench.mcs.tick([])
        bench.setpoints[bench.mcs.measured.tick] = bench.mcs.setpoint.copy()


def check(bench, course, until):
    """Compare a course with the setpoints up to a tick."""
    tick, course = course
    period_s = bench.mcs.config.servo.period_s
    seen = [(k - tick) * period_s for k in bench.setpoints if tick < k <= until]
    for joint in range(18):
        followed = [bench.setpoints[k][0, joint] for k in bench.setpoints if tick < k <= until]
        told = np.interp(course.seconds, seen, followed)
        within = course.seconds <= seen[-1]
        np.testing.assert_allclose(course.q[within, joint], told[within], atol=3e-5)


def begin(bench, cell, *offsets):
    points = [(cell.home[LEFT] + offset).tolist() for offset in offsets]
    bench.send("move", group="left", path={"kind": "joint", "points": points, "blend": 0.0})
    bench.setpoints[bench.mcs.measured.tick] = bench.mcs.setpoint.copy()


def test_a_motion_is_one_course_up_to_rest(followed, cell):
    begin(followed, cell, 0.3)
    run(followed, 2000)
    (course,) = followed.courses
    assert not course[1].v[-1].any()
    np.testing.assert_allclose(course[1].q[-1, LEFT], cell.home[LEFT] + 0.3, atol=1e-6)
    np.testing.assert_allclose(course[1].q[:, 9:], np.tile(cell.home[9:], (len(course[1].q), 1)))
    assert (np.diff(course[1].seconds) > 0.0).all()
    check(followed, course, max(followed.setpoints))


@pytest.mark.parametrize("change", ["pause", "protective_stop", "cancel"])
def test_a_stop_on_the_path_is_a_course_to_where_it_rests(followed, cell, change):
    begin(followed, cell, 0.5, 0.0)
    run(followed, 200)
    assert len(followed.courses) == 1
    arguments = {"protective_stop": {"reason": "somebody comes"}, "cancel": {"goal": followed._number}}
    at = followed.mcs.measured.tick
    followed.send(change, **arguments.get(change, {}))
    followed.setpoints[followed.mcs.measured.tick] = followed.mcs.setpoint.copy()
    run(followed, 600)
    first, second = followed.courses[0], followed.courses[1]
    assert not second[1].v[-1].any()
    assert second[1].seconds[-1] < first[1].seconds[-1]
    check(followed, first, at)
    check(followed, second, max(followed.setpoints))
    np.testing.assert_allclose(second[1].q[-1], followed.mcs.setpoint[0], atol=1e-6)
    assert len(followed.courses) == 2


def test_a_resumed_motion_goes_on_to_its_end(followed, cell):
    begin(followed, cell, 0.5)
    run(followed, 200)
    followed.send("pause")
    run(followed, 600)
    followed.send("resume")
    followed.setpoints[followed.mcs.measured.tick] = followed.mcs.setpoint.copy()
    run(followed, 1500)
    np.testing.assert_allclose(followed.courses[-1][1].q[-1, LEFT], cell.home[LEFT] + 0.5, atol=1e-6)
    check(followed, followed.courses[-1], max(followed.setpoints))
    np.testing.assert_allclose(followed.driver.q[LEFT], cell.home[LEFT] + 0.5, atol=1e-4)


@pytest.mark.parametrize("kind", ["setpoint", "jog"])
def test_a_stream_is_refused_by_name_and_nothing_moves(followed, cell, kind):
    values = {"setpoint": {"positions": (cell.home[LEFT] + 0.01).tolist()}, "jog": {"velocities": [0.1] * 9}}
    before = followed.mcs.setpoint.copy()
    for _ in range(30):
        reply = followed.ask("stream", group="left", kind=kind, lease_s=1.0, **values[kind])
        assert REFUSED in reply["error"]["message"]
        assert "evidence" not in reply["error"]["facts"]
    run(followed, 300)
    np.testing.assert_array_equal(followed.mcs.setpoint, before)
    assert followed.courses == []


def timed(cell, seconds, offset, velocity):
    q = (cell.home[LEFT] + offset)[None]
    points = TimedPoints(np.array([seconds]), q, np.full((1, 9), velocity), None)
    return {"kind": "trajectory", "points": pack_points(points)}


def test_trajectories_without_a_known_end_leave_the_motion_under_way_as_it_is(followed, cell):
    """A client that plans anew thirty times a second moved setpoints a little each time; then the robot leapt there."""
    begin(followed, cell, 0.5)
    run(followed, 100)
    goal = followed._number
    for _ in range(30):
        number = followed.send("move", group="left", path=timed(cell, 0.1, 0.1, 0.2), policy="replace")
        run(followed, 7)
        assert REFUSED in followed.reply(number)["error"]["message"]
    run(followed, 1500)
    assert followed.reply(goal)["success"]
    (course,) = followed.courses
    np.testing.assert_allclose(course[1].q[-1, LEFT], cell.home[LEFT] + 0.5, atol=1e-6)


def test_the_newest_of_two_trajectories_from_rest_is_followed(followed, cell):
    numbers = [
        followed.send("move", group="left", path=timed(cell, 1.0, offset, 0.0), policy="replace")
        for offset in (0.1, -0.1)
    ]
    run(followed, 1500)
    assert followed.reply(numbers[0])["error"]["code"] == "replaced"
    assert followed.reply(numbers[1])["success"]
    np.testing.assert_allclose(followed.courses[-1][1].q[-1, LEFT], cell.home[LEFT] - 0.1, atol=1e-6)


def test_a_line_and_a_motion_that_takes_over_are_courses(followed, cell, model):
    pose = model.pose(cell.home, "left_wrist")
    place = [*(pose.translation - [0.0, 0.0, 0.15]).tolist(), *pin.Quaternion(pose.rotation).coeffs().tolist()]
    followed.send("move", group="left", path={"kind": "line", "poses": [place], "speed": 0.1, "blend": 0.0})
    followed.setpoints[followed.mcs.measured.tick] = followed.mcs.setpoint.copy()
    run(followed, 250)
    (line,) = followed.courses
    at = followed.mcs.measured.tick
    check(followed, line, at)
    q = cell.home.copy()
    q[LEFT] = line[1].q[-1, LEFT]
    np.testing.assert_allclose(model.pose(q, "left_wrist").translation, place[:3], atol=1e-5)
    target = cell.home[LEFT] - 0.1
    path = {"kind": "joint", "points": [target.tolist()], "blend": 0.0}
    followed.send("move", group="left", path=path, policy="replace")
    followed.setpoints[followed.mcs.measured.tick] = followed.mcs.setpoint.copy()
    run(followed, 1500)
    check(followed, followed.courses[-1], max(followed.setpoints))
    np.testing.assert_allclose(followed.courses[-1][1].q[-1, LEFT], target, atol=1e-6)


def test_two_groups_are_in_one_course_and_each_ends_in_its_time(followed, cell):
    followed.to_motion("right")
    begin(followed, cell, 0.5)
    run(followed, 100)
    right = cell.home[9:] - 0.1
    followed.send("move", group="right", path={"kind": "joint", "points": [right.tolist()], "blend": 0.0})
    followed.setpoints[followed.mcs.measured.tick] = followed.mcs.setpoint.copy()
    run(followed, 1500)
    course = followed.courses[-1][1]
    np.testing.assert_allclose(course.q[-1], np.concatenate([cell.home[LEFT] + 0.5, right]), atol=1e-6)
    check(followed, followed.courses[-1], max(followed.setpoints))
    followed.send("estop", reason="red button")
    run(followed, 10)
    followed.ask("reset")
    followed.to_motion("left")
    count = len(followed.courses)
    run(followed, 200)
    assert len(followed.courses) == count, "an arm that stands needs no goal"


def test_a_robot_that_follows_slower_has_setpoints_at_its_speed(followed, cell):
    """The robot's clock goes slower; the points of a course are reached at those times of its clock."""
    begin(followed, cell, 0.5)
    run(followed, 100)
    followed.driver.speed = 0.5
    run(followed, 250)
    tick, course = followed.courses[-1]
    assert followed.mcs.groups["left"].speed == pytest.approx(0.5, abs=1e-3)
    run(followed, 2000)
    here = (tick, course._replace(seconds=course.seconds / 0.5))
    assert len([each for each, _ in followed.courses if each > tick]) == 0
    check(followed, here, max(followed.setpoints))
    np.testing.assert_allclose(course.q[-1, LEFT], cell.home[LEFT] + 0.5, atol=1e-6)


def test_a_robot_that_halts_itself_halts_the_setpoints_and_goes_on(followed, cell):
    begin(followed, cell, 0.5)
    run(followed, 150)
    followed.driver.speed = 0.0
    run(followed, 600)
    stood = followed.mcs.setpoint[0, LEFT].copy()
    assert (np.abs(stood - cell.home[LEFT] - 0.5) > 0.05).all()
    run(followed, 50)
    np.testing.assert_array_equal(followed.mcs.setpoint[0, LEFT], stood)
    followed.driver.speed = 1.0
    run(followed, 1500)
    np.testing.assert_allclose(followed.driver.q[LEFT], cell.home[LEFT] + 0.5, atol=1e-4)
