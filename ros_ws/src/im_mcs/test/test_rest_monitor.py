import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_mcs.group.rest_monitor import RestMonitor, RestPhase
from im_mcs.limits.configuration import load_config
from im_mcs.protocol.requests import SettleBounds

SERVO = load_config().servo
RESOLUTION, NOISE = np.full(3, 2e-5), np.full(3, 1e-5)
TARGET = np.array([0.1, -0.2, 0.3])


def readings(truth, seed):
    random = np.random.default_rng(seed)
    while True:
        yield np.rint((truth + random.standard_normal(3) * NOISE) / RESOLUTION) * RESOLUTION


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_the_mean_is_the_truth_within_its_variance(seed):
    truth = TARGET + np.array([7e-6, -2e-5, 3e-5])
    monitor = RestMonitor(RESOLUTION, NOISE, SERVO)
    for tick, q in zip(range(200), readings(truth, seed), strict=False):
        monitor.update(tick, q, TARGET)
        if monitor.at_rest:
            break
    assert monitor.at_rest
    assert tick < 120
    np.testing.assert_array_less(np.abs(monitor.q - truth), 5.0 * np.sqrt(monitor.variance))
    assert (np.sqrt(monitor.variance) < RESOLUTION / 4).all()


def test_a_moving_arm_is_not_at_rest_and_a_late_slip_starts_anew():
    monitor = RestMonitor(RESOLUTION, NOISE, SERVO)
    source = readings(TARGET, 1)
    for tick in range(100):
        monitor.update(tick, TARGET + 1e-5 * (100 - tick), TARGET)
    assert monitor.phase is RestPhase.SETTLING
    tick = 100
    while monitor.phase is not RestPhase.MEASURING:
        monitor.update(tick, next(source), TARGET)
        tick += 1
    for _ in range(SERVO.rest_window_ticks):
        monitor.update(tick, next(source) + 4e-5 * (tick % 44 > 20), TARGET)
        tick += 1
    assert monitor.phase is not RestPhase.AT_REST


def test_the_same_readings_give_the_same_tick():
    ends = []
    for _ in range(2):
        monitor = RestMonitor(RESOLUTION, NOISE, SERVO)
        for tick, q in zip(range(300), readings(TARGET, 9), strict=False):
            monitor.update(tick, q, TARGET)
            if monitor.at_rest:
                ends.append((tick, monitor.since_tick, monitor.q.tolist(), monitor.variance.tolist()))
                break
    assert ends[0] == ends[1]


def test_an_arm_off_its_setpoint_times_out():
    monitor = RestMonitor(RESOLUTION, NOISE, SERVO)
    for tick, q in zip(range(800), readings(TARGET + 1e-3, 2), strict=False):
        monitor.update(tick, q, TARGET)
    assert not monitor.at_rest
    assert monitor.timed_out
    assert abs(monitor.last_error[monitor.worst()]) > 9e-4


def test_an_arm_that_trembles_is_at_rest_late_and_told_less_surely():
    """A tremor of 150 urad, as of contact in the jaws, which noise does not explain."""
    source, random = readings(TARGET, 5), np.random.default_rng(5)
    monitor = RestMonitor(RESOLUTION, NOISE, SERVO)
    ticks = round(SERVO.settle.timeout_s / SERVO.period_s)
    tremor = 0.0
    for tick in range(ticks):
        tremor = 0.9 * tremor + 1.5e-4 * np.sqrt(1.0 - 0.9**2) * random.standard_normal()
        monitor.update(tick, next(source) + tremor, TARGET)
        if monitor.at_rest:
            break
    assert monitor.at_rest
    assert tick > ticks // 2
    assert (np.abs(monitor.q - TARGET) < 4.0 * np.sqrt(monitor.variance)).all()


def test_bounds_of_a_motion_hold_until_the_next_one():
    """An arm off its setpoint is at rest for one motion, out of time for the next, and judged as configured then."""
    ticks = round(SERVO.settle.timeout_s / SERVO.period_s)
    monitor, source = RestMonitor(RESOLUTION, NOISE, SERVO), readings(TARGET + 1.5e-3, 1)
    for bounds, at_rest, timed_out in (
        (SettleBounds(tolerance=2e-3), True, False),
        (SettleBounds(timeout_s=0.1), False, True),
        (SettleBounds(), False, False),
    ):
        monitor.bound(bounds)
        monitor.restart()
        for tick in range(ticks // 3):
            monitor.update(tick, next(source), TARGET)
        assert (monitor.at_rest, monitor.timed_out) == (at_rest, timed_out)


def test_braked_joints_need_no_setpoint():
    monitor = RestMonitor(RESOLUTION, NOISE, SERVO)
    for tick, q in zip(range(200), readings(TARGET, 4), strict=False):
        monitor.update(tick, q, None)
    assert monitor.at_rest


def test_an_arm_that_friction_holds_off_its_setpoint_is_at_rest_later_and_a_far_one_is_not():
    for off, rests in ((8e-5, True), (8e-4, False)):
        monitor = RestMonitor(RESOLUTION, NOISE, SERVO)
        ticks = round(SERVO.settle.timeout_s / SERVO.period_s)
        for tick, q in zip(range(ticks), readings(TARGET + off, 4), strict=False):
            monitor.update(tick, q, TARGET)
            if tick < ticks // 2:
                assert not monitor.at_rest
        assert monitor.at_rest is rests


def at_rest(truth, target):
    """A monitor that has measured rest, and the tick of it."""
    monitor = RestMonitor(RESOLUTION, NOISE, SERVO)
    for tick, q in zip(range(200), readings(truth, 4), strict=False):
        monitor.update(tick, q, target)
        if monitor.at_rest:
            return monitor, tick
    raise AssertionError("it does not come to rest")


@pytest.mark.parametrize("target", [TARGET, None])
def test_an_arm_that_is_moved_after_it_rested_comes_to_rest_anew(target):
    """As when something pushes it, or a brake slips."""
    monitor, begin = at_rest(TARGET, target)
    moved = TARGET + np.array([0.0, 4e-5, 0.0])
    source = readings(moved, 5)
    for tick in range(begin, begin + 2 * SERVO.settle.window_ticks):
        monitor.update(tick, next(source), target)
    assert not monitor.at_rest
    for tick in range(begin, begin + 500):
        monitor.update(tick, next(source), target)
    assert monitor.at_rest
    np.testing.assert_array_less(np.abs(monitor.q - moved), 5.0 * np.sqrt(monitor.variance))


def test_noise_alone_moves_no_arm():
    monitor, begin = at_rest(TARGET, TARGET)
    since = monitor.since_tick
    for tick, q in zip(range(begin, begin + 20_000), readings(TARGET, 6), strict=False):
        monitor.update(tick, q, TARGET)
    assert monitor.at_rest
    assert monitor.since_tick == since


def test_a_reading_that_is_none_is_no_rest():
    monitor, tick = at_rest(TARGET, None)
    for k in range(2 * SERVO.settle.window_ticks):
        monitor.update(tick + k, np.array([0.1, np.nan, 0.3]), None)
    assert not monitor.at_rest
