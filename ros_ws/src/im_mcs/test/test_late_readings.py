"""Readings that come late, several at once, or with stamps that say nothing, are no velocity."""

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from im_mcs.control.filters import VelocityEstimator
from im_mcs.limits.configuration import load_config
from im_mcs.safety.setpoint_history import SetpointHistory
from im_mcs.state import State
from im_mcs.testbed.stamp_clock import StampClock
from support.mcs_config import mcs_text

LEFT = slice(0, 9)
PERIOD_S = 0.0045


class LateMessages:
    """Readings of a driver as messages, of which some come late and in one piece.

    Args:
        driver: Has ``q``; one tick of it is a period.
        rate_hz: Of the robot's messages.
        stamp: Stamp of a message taken at a time; both in seconds.
        stall_s: Of each second, for how long nothing is delivered; then all comes at once.
        split: Share of what comes at once that comes a tick earlier than the rest.
        jitter_s: Largest delay of a message at other times.
        lost: Share of messages that are lost.
    """

    def __init__(self, driver, rate_hz, stamp, stall_s=0.0, split=0.0, jitter_s=0.0, lost=0.0):
        self.driver, self.rate_hz, self.stamp = driver, rate_hz, stamp
        self.stall_s, self.split, self.jitter_s, self.lost = stall_s, split, jitter_s, lost
        self.random, self.clock = np.random.default_rng(7), StampClock()
        self.before, self.coming, self.count = None, [], 0
        self.tell = type(driver).read

    def delivered_s(self, taken_s):
        came_s = taken_s + self.random.random() * self.jitter_s
        since_s = came_s % 1.0
        if since_s >= self.stall_s:
            return came_s
        end_s = came_s - since_s + self.stall_s
        return end_s - PERIOD_S if since_s < self.split * self.stall_s else end_s

    def __call__(self):
        measured = self.tell(self.driver)
        now = 5.0 + 1e-9 * measured.stamp_ns
        if self.before is None:
            self.before = now, measured.q
            self.taken_s, self.q = now, measured.q
        while (taken_s := 5.0 + self.count / self.rate_hz) <= now:
            (then, q), self.count = self.before, self.count + 1
            share = (taken_s - then) / (now - then) if now > then else 1.0
            came_s = max(self.delivered_s(taken_s), self.coming[-1][0] if self.coming else 0.0)
            if self.random.random() >= self.lost:
                self.coming.append((came_s, taken_s, q + share * (measured.q - q)))
        self.before = now, measured.q
        while self.coming and self.coming[0][0] <= now:
            came_s, taken_s, self.q = self.coming.pop(0)
            self.taken_s = self.clock.taken_s(self.stamp(taken_s), came_s)
        return measured._replace(q=self.q.copy(), age_s=np.full(18, now - self.taken_s))


@pytest.fixture
def robot(tmp_path, make_bench):
    """A robot that takes positions, and may be blind for half a second."""
    data = yaml.safe_load(mcs_text())
    settings_ = {"inertia": [1.0], "q": [0.0]}
    driver = {"driver": "im_mcs.testbed.loopback:LoopbackDriver", "settings": settings_}
    data["testbed"]["drivers"]["testbed"] = driver
    for slot in data["slots"]:
        if slot.get("kind", "joint") == "joint":
            slot["interface"] = "position"
    data["control"] = {"controller": "im_mcs.control.setpoints:SetpointPosition"}
    data["safety"].update(driver_age_s=0.5, driver_age_estop_s=1.0)
    path = tmp_path / "mcs.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return make_bench(load_config(path))


def own_clock(taken_s):
    return taken_s - 3.0e6


#: Messages a second, and what becomes of them.
STREAMS = [
    (125.0, {"stall_s": 0.1}),
    (125.0, {"stall_s": 0.3}),
    (125.0, {"stall_s": 0.3, "split": 0.5}),
    (125.0, {"stall_s": 0.2, "split": 0.2, "lost": 0.1, "jitter_s": 0.006}),
    (25.0, {"stall_s": 0.3, "split": 0.4}),
    (500.0, {"stall_s": 0.3, "split": 0.5, "jitter_s": 0.003}),
    (500.0, {}),
    (25.0, {"jitter_s": 0.02}),
]


@pytest.mark.parametrize(("rate_hz", "stream"), STREAMS)
def test_a_motion_within_limits_ends_well_whenever_its_readings_come(robot, cell, rate_hz, stream):
    robot.driver.read = late = LateMessages(robot.driver, rate_hz, own_clock, **stream)
    for _ in range(300):
        robot.mcs.tick([])
    robot.to_motion("left")
    points = [(cell.home[LEFT] + 0.4).tolist(), cell.home[LEFT].tolist()] * 2
    points = [*points, (cell.home[LEFT] + 0.1).tolist()]
    goal = robot.send("move", group="left", path={"kind": "joint", "points": points})
    found, true, ages = [], [], []
    for _ in range(3000):
        robot.mcs.tick([])
        found.append(robot.mcs.v[LEFT].copy())
        true.append(robot.driver.v[LEFT].copy())
        ages.append(robot.mcs.measured.age_s[0])
        assert robot.mcs.manager.state is State.MOTION, robot.mcs.manager.cause
        assert robot.mcs.groups["left"].protective is None
        if robot.reply(goal) is not None:
            break
    assert robot.reply(goal)["success"], robot.reply(goal)
    fastest = np.abs(true).max(axis=0)
    assert (fastest > 0.1).any()
    assert (np.abs(found).max(axis=0) < 1.15 * fastest).all()
    assert late.clock._keeps_pace or rate_hz < 100.0
    assert stream.get("stall_s", 0.0) - 2.0 / rate_hz <= max(ages)


@pytest.mark.parametrize("rate_hz", [25.0, 125.0, 500.0])
def test_a_joint_that_runs_away_is_stopped_as_soon_as_its_readings_tell(robot, cell, rate_hz):
    limit = 1.5 * robot.mcs.limits.ceiling.velocity[4]
    robot.driver.read = LateMessages(robot.driver, rate_hz, own_clock, jitter_s=0.1 / rate_hz)
    for _ in range(300):
        robot.mcs.tick([])
    robot.to_motion("left")
    robot.mcs.groups["left"].planner.rate = 1.0
    ticks = 0
    while robot.mcs.manager.state is State.MOTION:
        robot.driver.q[4] += 3.0 * limit * PERIOD_S
        robot.mcs.tick([])
        ticks += 1
        assert ticks < 100
    assert ticks <= 3 + 1.2 / (rate_hz * PERIOD_S)
    assert "left_j2" in robot.mcs.manager.cause


@pytest.mark.parametrize(
    "stamp",
    [
        lambda taken_s: 0.0,
        lambda taken_s: 12.0,
        lambda taken_s: 7.0 + 0.3 * taken_s,
        lambda taken_s: 7.0 + 2.0 * taken_s,
        lambda taken_s: taken_s - 4.0 * int(taken_s),
        lambda taken_s: taken_s + 4.0 * int(taken_s),
        lambda taken_s: 1e9 - taken_s,
        lambda taken_s: taken_s - 0.01 * int(taken_s),
    ],
    ids=["none", "stands", "slow", "fast", "set back", "set forward", "backwards", "set back a little"],
)
def test_a_stamp_that_says_nothing_neither_ages_a_reading_nor_makes_it_fast(stamp):
    clock, estimator = StampClock(), VelocityEstimator(1, PERIOD_S, 150.0)
    for tick in range(4000):
        now = 5.0 + 0.008 * tick
        taken_s = clock.taken_s(stamp(now), now)
        age_s = now - taken_s
        assert 0.0 <= age_s < 0.02
        v = estimator.update_at(np.array([0.5 * now]), round(1e9 * now), np.array([age_s]))
        assert abs(v[0]) < 0.5 * 1.3
    assert v[0] == pytest.approx(0.5, rel=0.05)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.002, 0.04), st.floats(0.0, 0.004))
def test_times_of_readings_rise_and_are_as_the_stamps_say(seed, period_s, jitter_s):
    random, clock, last = np.random.default_rng(seed), StampClock(), 0.0
    for k in range(int(3.0 / period_s)):
        taken_s = 9.0 + k * period_s
        since_s = taken_s % 0.6
        came_s = max(taken_s + (0.2 - since_s if since_s < 0.2 else random.random() * jitter_s), last)
        found = clock.taken_s(taken_s + 4.5e8, came_s)
        assert found <= came_s
        if k * period_s > 1.0 and clock._keeps_pace:
            assert abs(found - taken_s) < jitter_s + 1e-3
        last = came_s


@settings(deadline=None)
@given(st.lists(st.floats(0.002, 0.4), min_size=20, max_size=60), st.floats(-2.0, 2.0))
def test_the_slope_is_found_whatever_time_passes_between_readings(times, slope):
    estimator, now = VelocityEstimator(2, PERIOD_S, 150.0), 0.0
    for dt in [*times, *[0.05] * 5]:
        now += max(dt, PERIOD_S)
        v = estimator.update_at(np.array([slope * now, 1.0]), round(1e9 * (now + 7.0)), np.array([7.0, 7.0]))
    np.testing.assert_allclose(v, [slope, 0.0], atol=1e-5)


def test_readings_of_each_tick_are_filtered_as_before_to_the_bit():
    plain, stamped = (VelocityEstimator(3, PERIOD_S, 150.0) for _ in range(2))
    random = np.random.default_rng(1)
    for tick in range(50):
        x = random.normal(size=3)
        found = stamped.update_at(x, tick * 4_500_000, np.zeros(3))
        np.testing.assert_array_equal(found, plain.update(x))


def test_a_joint_without_a_newer_reading_keeps_its_velocity_and_the_others_go_on():
    estimator = VelocityEstimator(2, PERIOD_S, 150.0)
    for tick in range(200):
        x, age_s = 0.3 * PERIOD_S * tick, 0.0 if tick < 100 else PERIOD_S * (tick - 100)
        y = 0.3 * PERIOD_S * min(tick, 100)
        v = estimator.update_at(np.array([x, y]), tick * 4_500_000, np.array([0.0, age_s]))
    np.testing.assert_allclose(v, [0.3, 0.3], rtol=1e-6)
    for tick in range(200, 400):  # an age that is none hides no motion
        x = 0.3 * PERIOD_S * tick
        v = estimator.update_at(np.array([x, x]), tick * 4_500_000, np.array([0.0, np.nan if tick % 2 else np.inf]))
    np.testing.assert_allclose(v, [0.3, 0.3], rtol=1e-6)
    with pytest.raises(ValueError, match="no array of 2 floats"):
        estimator.update_at(np.zeros(3), 0, np.zeros(2))
    with pytest.raises(ValueError, match="no array of 2 floats"):
        estimator.update_at(np.zeros(2), 0, np.zeros(3))


def test_a_late_reading_meets_the_setpoint_of_its_time():
    history = SetpointHistory(np.array([1.0, 2.0]), 0.01, longest_s=0.05)
    for k in range(8):
        history.push_setpoint(np.array([[k, 10 + k], [0.1 * k, 0.0], [0.0, 0.0]]))
    for age_s, expected in (
        ([0.0, 0.0], [7, 17]),
        ([0.004, 0.0], [7, 17]),
        ([0.02, 0.031], [5, 14]),
        ([9.0, np.nan], [2, 17]),
        ([np.inf, -1.0], [2, 17]),
    ):
        assert history.at(np.array(age_s))[0].tolist() == expected
    np.testing.assert_allclose(history.at(np.array([0.03, 0.0]))[1], [0.4, 0.0])
