"""Streams as moveit_servo sends them, targets for now, velocities at the end: followed, and rest behind them."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from im_core.errors import DataError, LimitError, StateError
from im_mcs.client.trajectory import OldStampError, Present, TimedTrajectory, trajectory_path
from im_mcs.planning.motions.window import WindowPreparation
from im_mcs.protocol.points import TimedPoints, pack_points
from im_mcs.protocol.requests import TrajectoryMove

AHEAD_S, RATE_HZ = 0.1, 30.0
SIZE, SPEED = 0.3, 0.3
"""Of the sine that a stream follows [rad, rad/s]."""


def ask(rig, time, q, v=None, **more):
    point = {"time": time, "positions": q.tolist()} | ({} if v is None else {"velocities": v.tolist()})
    return rig.request({"kind": "trajectory", "points": [point], "stream": True} | more, policy="replace")


@dataclass
class ServoNode:
    """A sender as moveit_servo of Jazzy is one, with its defaults.

    It keeps the states of the last 0.1 s and of the next 0.1 s, each stamped with the moment for which it is meant,
    and sends all but the newest one, stamped with the first. The velocity of a state is the smaller difference quotient
    of both sides, 0 where the joint turns round.
    """

    latency_s: float = 0.1
    window: list = field(default_factory=list)

    def message(self, now_s, course):
        """The next message: stamp, times, positions and velocities; None while there are fewer than three states."""
        stamp = now_s + self.latency_s
        self.window = [state for state in self.window if state[0] >= now_s - self.latency_s and state[0] != stamp]
        q, v = course(stamp)
        if len(self.window) >= 2:
            (t0, q0, _), (t1, q1, _) = self.window[-2:]
            after, before = (q - q1) / (stamp - t1), (q1 - q0) / (t1 - t0)
            v = np.where(after * before < 0.0, 0.0, np.where(np.abs(after) < np.abs(before), after, before))
            self.window[-1] = (t1, q1, v)
        self.window.append((stamp, q, v))
        if len(self.window) < 3:
            return None
        times, q, v = (np.array(column) for column in zip(*self.window[:-1], strict=True))
        return float(times[0]), times - times[0], q, v


def send(rig, stamp_s, times, q, v, age_s):
    """A message to the topic, on the way that the node takes: it knows the arm by a snapshot of some age."""
    then = max(len(rig.trace) - 1 - round(age_s / rig.period), 0)
    setpoint = rig.trace[then]
    asked = TimedTrajectory(list(range(9)), times, q, v, None, stamp_s)
    present = Present((then + 1) * rig.period, setpoint.q, not (setpoint.v.any() or setpoint.a.any()))
    return rig.request(trajectory_path("left", list(range(9)), asked, present, stream=True), policy="replace")


def sine(rig, way):
    """Where a tool is led along a sine, from rest at its turn; ``way`` has a largest part of 1."""
    return lambda t: (
        rig.home + SIZE * (1.0 - np.cos(SPEED / SIZE * t)) * way,
        SPEED * np.sin(SPEED / SIZE * t) * way,
    )


def lag_and_error(rig, course, begin_s):
    """The lag [s] at which the setpoints are closest to a course, and how far off they are then."""
    times = rig.period * np.arange(len(rig.trace))
    some = times >= begin_s
    lags = np.arange(-0.01, 0.06, 0.001)
    off = [np.abs(rig.q[some] - np.array([course(t - lag)[0] for t in times[some]])).max() for lag in lags]
    return lags[int(np.argmin(off))], min(off)


def none_is_refused(rig, goals):
    """Each has taken the place of the one before; a first one, where the arm is already, may have ended."""
    assert {rig.code(goal) for goal in goals if goal in rig.results} <= {"replaced", None}


def led(rig, course, rate_hz, seconds, compose, random):
    """Lead the arm for some seconds with what ``compose`` makes of each moment; the numbers of the goals."""
    goals, due = [], 0.0
    while (now := (rig.tick + 1) * rig.period) < seconds:
        while now >= due:
            message = compose(due, course)
            if message is not None:
                goals.append(send(rig, *message, age_s=random.uniform(0.0, 0.018)))
            due += random.uniform(0.8, 1.2) / rate_hz
        rig.ticks(1)
    return goals


@pytest.mark.parametrize("share", [0.14, 0.1, 0.05])
def test_the_speed_that_is_set_bounds_a_stream_at_once_and_lets_it_catch_up(rig, way, share):
    course, servo = sine(rig, way / way.max()), ServoNode()

    def message(now_s, course):
        rig.group.set_speed(share if 1.2 <= now_s < 3.0 else 1.0)
        return servo.message(now_s, course)

    none_is_refused(rig, led(rig, course, 100, 5.0, message, np.random.default_rng(1)))
    fastest = np.abs(rig.v / rig.limits.velocity).max(axis=1)
    slow = slice(round(1.6 / rig.period), round(3.0 / rig.period))
    assert fastest[: round(1.2 / rig.period)].max() > 1.3 * share
    assert 0.9 * share < fastest[slow].max() <= share + 1e-3
    assert ((rig.q[slow.stop] - rig.q[slow.start]) * way > 0.0).all()
    off = np.abs(rig.q[-1] - course((len(rig.trace) - 1) * rig.period)[0]).max()
    assert off < 0.02
    rig.check_motion(acceleration=1.03, jerk=1.1)


@pytest.mark.parametrize("rate_hz", [30, 100])
def test_windows_of_moveit_servo_are_followed(rig, way, rate_hz):
    course = sine(rig, way / way.max())
    goals = led(rig, course, rate_hz, 8.0, ServoNode().message, np.random.default_rng(rate_hz))
    none_is_refused(rig, goals)
    lag, off = lag_and_error(rig, course, 1.0)
    assert lag <= 0.025
    assert off <= 0.01
    at_rest_in_the_end(rig)
    rig.check_motion(jerk=1.1)


def single(ahead_s, stamped, velocities):
    """Single points: ``ahead_s`` ahead of the moment, with stamp 0 or the moment as stamp."""

    def message(now_s, course):
        q, v = course(now_s + ahead_s)
        return now_s if stamped else 0.0, np.array([ahead_s]), q[None], v[None] if velocities else None

    return message


@pytest.mark.parametrize(
    ("rate_hz", "ahead_s", "stamped"), [(30, 0.1, True), (30, 0.0333, False), (30, 0.0, True), (250, 0.004, False)]
)
def test_single_points_are_followed_whatever_their_stamp(rig, way, rate_hz, ahead_s, stamped):
    course = sine(rig, way / way.max())
    compose = single(ahead_s, stamped, velocities=True)
    goals = led(rig, course, rate_hz, 8.0, compose, np.random.default_rng(rate_hz))
    none_is_refused(rig, goals)
    lag, off = lag_and_error(rig, course, 1.0)
    assert lag <= 0.025
    assert off <= 0.01
    at_rest_in_the_end(rig)
    rig.check_motion(jerk=1.1)


@pytest.mark.parametrize("late_s", [0.05])
def test_windows_and_points_that_come_late_are_followed_in_their_own_time(rig, way, late_s):
    course = sine(rig, way / way.max())

    def late(now_s, course):
        return single(0.0, True, velocities=True)(max(now_s - late_s, 0.001), course)

    goals = led(rig, course, 30, 8.0, late, np.random.default_rng(1))
    none_is_refused(rig, goals)
    lag, off = lag_and_error(rig, course, 1.0)
    assert lag <= 0.025
    assert off <= 0.01


def test_times_that_are_the_same_but_for_rounding_are_no_division_by_zero(rig, way):
    random = np.random.default_rng(0)
    for _ in range(300):
        steps = random.choice([1e-9, 0.0045, 0.01, 0.033], size=random.integers(1, 8))
        times = np.cumsum(steps) - steps[0]
        q, v = rig.home + 0.2 * times[:, None] * way, np.tile(0.2 * way, (len(times), 1))
        move = TrajectoryMove(points=pack_points(TimedPoints(times, q, v, None)), stream=True)
        edge = random.choice(times) + random.choice([0.0, -0.1, 1e-17, -1e-17, 1e-12, -1e-12])
        preparation = WindowPreparation(rig.context, move, lambda: rig.trace[-1], lambda edge=edge: float(edge))
        with np.errstate(all="raise"):
            course = preparation.step()
        assert np.isfinite(course.coefficients).all()
        assert np.abs(course.end_setpoint.q - rig.home).max() < 0.5


def test_what_ended_long_ago_is_refused(rig, way):
    rig.ticks(200)
    with pytest.raises(OldStampError, match="before now"):
        send(rig, 0.5, np.array([0.0]), rig.home[None], None, age_s=0.0)
    with pytest.raises(DataError, match="last point"):  # far ahead it is no window
        send(rig, 0.0, np.array([1.0]), rig.home[None], way[None], age_s=0.0)


def test_a_window_with_steps_and_spikes_is_followed_within_limits(rig, way):
    """Noise of positions and stamps makes difference quotients of any size: none is refused for that."""
    random, course = np.random.default_rng(4), sine(rig, way / way.max())

    def noisy(t):
        q, v = course(t)
        return q + 2e-4 * random.standard_normal(9), v

    goals = led(rig, noisy, 100, 4.0, ServoNode().message, random)
    none_is_refused(rig, goals)
    assert lag_and_error(rig, course, 1.0)[1] <= 0.02
    at_rest_in_the_end(rig)
    rig.check_motion(jerk=1.6)


def stream(rig, course, seconds, *, velocities=True, late_s=0.0):
    """Send where a course, which gives q and v at a time, will be; returns how far off it the setpoint was, by tick."""
    off, sent = [], 0
    random = np.random.default_rng(3)
    while (now := rig.tick * rig.period) < seconds:
        if now * RATE_HZ >= sent:
            q, v = course(now + AHEAD_S + late_s * random.standard_normal())
            ask(rig, AHEAD_S, q, v if velocities else None)
            sent += 1
        rig.ticks(1)
        off.append(rig.trace[-1].q - course(rig.tick * rig.period)[0])
    return np.array(off)


def ramp(rig, way, speed=0.2):
    return lambda t: (rig.home + speed * t * way, speed * way)


def swing(rig, way, size=0.2, pace=1.0):
    return lambda t: (rig.home + size * way * (1.0 - np.cos(pace * t)), size * pace * way * np.sin(pace * t))


def at_rest_in_the_end(rig):
    rig.run()
    assert not rig.trace[-1].v.any()
    assert not rig.trace[-1].a.any()
    return rig.trace[-1].q


@pytest.mark.parametrize("late_s", [0.0, 0.002])
def test_a_stream_along_a_ramp_is_caught_up_with_and_followed(rig, way, late_s):
    off = stream(rig, ramp(rig, way), 3.0, late_s=late_s)
    speed = 0.2 * np.abs(way).max()
    assert np.abs(off).max() < speed * 0.15  # from rest: behind by no more than 0.15 s
    assert np.abs(off[222:]).max() < speed * (2.0 * rig.context.period_s + 4.0 * late_s)  # after a second
    before = rig.trace[-1].q
    end = at_rest_in_the_end(rig)
    assert (np.abs(end - before) < speed * 0.5).all()
    rig.check_motion(jerk=1.6)
    assert {rig.code(goal) for goal in rig.results} == {"replaced", None}


@pytest.mark.parametrize(("size", "pace"), [(0.1, 2.0)])
def test_a_stream_along_a_sine_is_followed(rig, way, size, pace):
    off = stream(rig, swing(rig, way, size, pace), 6.0, late_s=0.001)
    assert np.abs(off / way).max() < 0.05 * size
    at_rest_in_the_end(rig)
    rig.check_motion(jerk=1.6)


def test_a_stream_of_positions_alone_lags_and_arrives(rig, way):
    off = stream(rig, ramp(rig, way), 2.0, velocities=False)
    assert np.abs(off / way).max() < 0.2 * 0.4
    np.testing.assert_allclose(at_rest_in_the_end(rig), ramp(rig, way)(1.98 + AHEAD_S)[0], atol=0.01)
    rig.check_motion(jerk=1.6)


def test_a_stream_that_ends_with_a_velocity_of_0_ends_in_its_last_point(rig, way):
    stream(rig, ramp(rig, way), 2.0)
    last = ramp(rig, way)(2.0)[0]
    goal = ask(rig, AHEAD_S, last, np.zeros(9))
    np.testing.assert_allclose(at_rest_in_the_end(rig), last, atol=1e-9)
    assert rig.code(goal) is None
    rig.check_motion(jerk=1.6)


def test_a_stream_towards_the_end_of_a_joint_is_refused_where_the_arm_could_not_stop(rig, way):
    edge, speed = rig.all_limits.upper[8], 2.0
    only = np.eye(9)[8]

    def course(t):
        return rig.home + np.clip(speed * t, 0.0, edge - 1e-3) * only, speed * only

    stream(rig, course, 3.0)
    refused = [fault for fault, _, _ in rig.results.values() if fault is not None and fault.code == "limit"]
    assert refused
    assert "left_j6: position at" in refused[0].message
    assert at_rest_in_the_end(rig)[8] < edge
    assert rig.q[:, 8].max() < edge


@pytest.mark.parametrize("windows", [True, False])
def test_a_pause_halts_whatever_goes_on_being_sent(rig, way, windows):
    course = sine(rig, way / way.max())
    refused = 0

    def until(seconds):
        nonlocal refused
        while (now := rig.tick * rig.period) < seconds:
            if rig.tick % 7 == 0:
                q, v = course(now + AHEAD_S)
                if windows:
                    try:
                        ask(rig, AHEAD_S, q, v)
                    except StateError:
                        refused += 1
                else:
                    points = [(now + ahead, *course(now + ahead)) for ahead in (AHEAD_S, 1.0)]
                    rig.request({
                        "kind": "trajectory",
                        "points": [
                            {"time": time - now, "positions": q.tolist(), "velocities": (v * last).tolist()}
                            for (time, q, v), last in zip(points, (1.0, 0.0), strict=True)
                        ],
                    }, policy="replace")  # fmt: skip
            rig.ticks(1)

    until(2.0)
    assert refused == 0
    rig.group.pause()
    until(2.6)
    halted = rig.trace[-1].q
    until(4.0)
    np.testing.assert_array_equal(rig.trace[-1].q, halted)
    assert (refused > 0) == windows
    rig.group.resume()
    until(6.0)
    assert np.abs(rig.trace[-1].q - course(6.0)[0]).max() < 0.02
    at_rest_in_the_end(rig)
    rig.check_motion(jerk=1.6)


@pytest.mark.parametrize("appended", [False, True])
def test_a_move_after_a_stream_that_fell_silent_begins_where_the_arm_rests(rig, way, appended):
    stream(rig, swing(rig, way, 0.1, 2.0), 1.2)
    if not appended:
        at_rest_in_the_end(rig)
    goal = rig.move(rig.home, policy="append" if appended else "refuse")
    np.testing.assert_allclose(at_rest_in_the_end(rig), rig.home, atol=1e-9)
    assert rig.code(goal) is None
    rig.check_motion(jerk=1.6)


def test_one_point_at_time_0_is_gone_to_at_once(rig, way):
    for offset in (0.0, 1e-4, 0.2):
        goal = ask(rig, 0.0, rig.home + offset * way, stream=False)
        np.testing.assert_allclose(at_rest_in_the_end(rig), rig.home + offset * way, atol=1e-9)
        assert rig.code(goal) is None
    rig.check_motion()


def test_behind_a_velocity_at_the_end_the_motion_decelerates_to_rest(rig, way):
    q, v = rig.home + 0.3 * way, 0.2 * way
    points = [
        {"time": 2.0, "positions": (rig.home + 0.15 * way).tolist(), "velocities": (0.15 * way).tolist()},
        {"time": 3.0, "positions": q.tolist(), "velocities": v.tolist()},
    ]
    for point in points:
        point["accelerations"] = [0.0] * 9
    goal = rig.request({"kind": "trajectory", "points": points})
    end = at_rest_in_the_end(rig)
    assert rig.code(goal) is None
    at = int(np.argmin(np.abs(rig.q - q).sum(axis=1)))
    np.testing.assert_allclose(rig.q[at], q, atol=2e-3)
    np.testing.assert_allclose(rig.v[at], v, atol=1e-2)
    assert (np.sign(end - q) == np.sign(v)).all()
    assert (np.abs(end - q) >= 0.5 * v**2 / rig.limits.acceleration).all()
    rig.check_motion()


def test_behind_a_velocity_at_the_end_there_must_be_room_to_stop(rig):
    q, v = rig.home.copy(), np.zeros(9)
    q[8], v[8] = rig.all_limits.upper[8] - 0.01, 2.0
    goal = rig.request(
        {"kind": "trajectory", "points": [{"time": 5.0, "positions": q.tolist(), "velocities": v.tolist()}]}
    )
    rig.ticks(50)
    fault = rig.results[goal][0]
    assert isinstance(fault, LimitError)
    assert "left_j6: position at" in fault.message
    assert not rig.trace[-1].v.any()
