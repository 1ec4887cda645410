"""The compiled steps of a servo tick against the same in numpy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_mcs.control.feedback import FeedbackParameters
from im_mcs.control.filters import VelocityEstimator, friction_torque, model_torque
from im_mcs.limits.braking import flags_within, stopping_place, way_to_rest
from im_mcs.limits.vectors import all_finite, any_beyond, clip

DT = 0.0045
ODD = np.array([0.0, -0.0, 1.0, -2.0, 1e300, np.inf, -np.inf, np.nan])


def within_band(x, band):
    return x - np.clip(x, -band, band)


class NumpyVelocity:
    """Backward difference through a first-order low pass."""

    def __init__(self, n, bandwidth):
        self.decay = math.exp(-bandwidth * DT)
        self.gain = (1.0 - self.decay) / DT
        self.last, self.value = None, np.zeros(n)

    def update(self, x):
        if self.last is not None:
            value = self.decay * self.value + self.gain * (x - self.last)
            self.value = np.where(np.isfinite(x) & ~np.isfinite(value), 0.0, value)
        self.last = x
        return self.value


class NumpyFeedback:
    """PID with a dead band at rest, and an integral without wind-up."""

    def __init__(self, p, inertia, limit):
        self.p, self.limit = p, limit
        self.kp = inertia * p.bandwidth_rad_s**2
        self.kd = 2.0 * p.damping * p.bandwidth_rad_s * inertia
        self.ki_dt = self.kp * p.integral_rad_s * DT
        self.rate = NumpyVelocity(len(inertia), p.derivative_bandwidth_rad_s)
        self.smooth = self.integral = np.zeros(len(inertia))

    def update(self, error, holding):
        if holding:
            error = self.smooth + within_band(error - self.smooth, self.p.rest_deadband)
        else:
            self.smooth = self.smooth + (1.0 - math.exp(-DT / 0.02)) * (error - self.smooth)
        self.error = error
        return self.kp * error + self.kd * self.rate.update(error) + self.integral

    def integrate(self, tau, limit, holding):
        if not holding:
            step = self.ki_dt * within_band(self.error, self.p.deadband)
            step = np.where((np.abs(tau) < limit) | (tau * self.error < 0.0), step, 0.0)
            self.integral = np.clip(self.integral + step, -self.limit, self.limit)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32), st.integers(1, 18))
def test_feedback_is_that_of_numpy_to_the_bit(seed, n):
    rng = np.random.default_rng(seed)
    p = FeedbackParameters(
        bandwidth_rad_s=20.0, damping=0.7, integral_rad_s=5.0, derivative_bandwidth_rad_s=200.0, integral_limit=0.3,
        deadband=1e-4, rest_deadband=1e-4,
    )  # fmt: skip
    inertia, limit = rng.uniform(0.1, 5.0, n), rng.uniform(1.0, 10.0, n)
    compiled, numpy = p.feedback(inertia, 0.3 * limit, DT), NumpyFeedback(p, inertia, 0.3 * limit)
    for tick in range(60):
        holding = 20 < tick < 40
        compiled.hold(holding)
        error = 10.0 ** rng.uniform(-6, -1) * rng.normal(size=n)
        answer = compiled.update(error)
        np.testing.assert_array_equal(answer, numpy.update(error, holding))
        compiled.integrate(answer, limit)
        numpy.integrate(answer, limit, holding)
        np.testing.assert_array_equal(compiled.smooth_error, numpy.smooth)
    v = rng.normal(size=n) * rng.integers(0, 2, n)
    positive, negative, viscous = rng.uniform(0.0, 3.0, (3, n))
    for pushed in (None, compiled):
        direction = 0.8 * np.tanh(v / 1e-3)
        if pushed is not None:
            excess = np.clip(np.abs(numpy.smooth) / 1e-4 - 1.0, 0.0, 1.0)
            direction = np.where(v != 0.0, direction, 0.5 * np.copysign(excess, numpy.smooth))
        torque = friction_torque(v, np.tanh(v / 1e-3), 0.8, 0.5, positive, negative, viscous, pushed)
        expected = np.where(direction > 0.0, positive, negative) * direction + viscous * v
        np.testing.assert_array_equal(torque, expected)
    push, v = 0.5 * np.copysign(excess, numpy.smooth), 1e-3 * v
    turns = np.tanh(v / 1e-3)
    creeping = np.where(v == 0.0, push, 0.8 * turns + (1.0 - np.abs(turns)) * push)
    torque = friction_torque(v, turns, 0.8, 0.5, positive, negative, viscous, compiled, creeping=True)
    np.testing.assert_array_equal(torque, np.where(creeping > 0.0, positive, negative) * creeping + viscous * v)


def test_torques_of_the_model_are_those_of_numpy_to_the_bit():
    gravity, friction, inertia, *a = np.random.default_rng(4).normal(size=(5, 18))
    strided = np.array(a).T[:, 1]
    for share in (0.0, 0.7, 1.0):
        alone = model_torque(share, gravity, friction, 0.9, None, strided)
        np.testing.assert_array_equal(alone, share * gravity + friction)
        moving = model_torque(share, gravity, friction, 0.9, inertia, strided)
        np.testing.assert_array_equal(moving, alone + 0.9 * inertia * strided)
    with pytest.raises(ValueError, match="17 accelerations are given for 18 joints"):
        model_torque(1.0, gravity, friction, 0.9, inertia, strided[1:])
    with pytest.raises(ValueError, match="no array of 18 floats"):
        model_torque(1.0, gravity, friction[1:], 0.9, None, strided)


def test_a_velocity_without_readings_is_none_and_begins_anew():
    rng = np.random.default_rng(2)
    compiled, numpy = VelocityEstimator(4, DT, 200.0), NumpyVelocity(4, 200.0)
    for tick in range(30):
        reading = rng.normal(size=4)
        reading[tick % 4] = [1.0, np.nan, np.inf][tick % 3]
        with np.errstate(invalid="ignore"):
            np.testing.assert_array_equal(compiled.update(reading), numpy.update(reading))
    with pytest.raises(ValueError, match="no array of 4 floats"):
        compiled.update(np.zeros(3))


@pytest.mark.parametrize("low", ODD[:5])
def test_vectors_are_those_of_numpy(low):
    bounds = np.abs(np.full(len(ODD), low))
    np.testing.assert_array_equal(clip(ODD, -bounds, bounds), np.minimum(np.maximum(ODD, -bounds), bounds))
    for x in ODD:
        one = np.array([0.5, x])
        assert all_finite(one) == np.isfinite(one).all()
        assert any_beyond(one, np.full(2, bounds[0])) == (np.abs(one) > bounds[0]).any()
    with pytest.raises(ValueError, match="2 numbers have 3 bounds"):
        any_beyond(np.zeros(2), np.zeros(3))


@settings(deadline=None)
@given(st.floats(-2.0, 2.0), st.floats(0.0, 1.5), st.floats(0.0, 3.0))
def test_the_way_to_rest_is_that_of_the_profile_step_by_step(q, v, a):
    most, jerk, dt = 3.0, 20.0, 1e-5
    place, speed, acceleration = q, v, a
    while acceleration > 0.0:
        acceleration = max(acceleration - jerk * dt, 0.0)
        place, speed = place + speed * dt, speed + acceleration * dt
    left = way_to_rest(max(speed, 0.0), 0.0, most, jerk)
    assert stopping_place(q, v, a, most, jerk) == pytest.approx(place + left, abs=1e-3)
    assert way_to_rest(v, a, most, jerk) == pytest.approx(place + left - q, abs=1e-3)


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 2**32), st.integers(1, 18))
def test_flags_of_setpoints_are_those_of_numpy(seed, n):
    rng = np.random.default_rng(seed)
    last, bounds = rng.normal(size=(3, n)), 10.0 ** rng.uniform(-1, 1, (6, n))
    step = np.array([[1.0, DT, DT * DT / 2.0], [0.0, 1.0, DT], [0.0, 0.0, 1.0]])
    wanted = step @ last + rng.normal(size=(3, n)) * rng.uniform(0.0, 2.0)
    wanted[0, 0] = np.nan if seed % 7 == 0 else wanted[0, 0]
    ends = np.sort(rng.normal(size=(2, n)), axis=0)
    slopes, hardest = rng.uniform(0.1, 1.0, (2, n)), rng.uniform(1.0, 9.0, (2, n))
    rows = np.abs(np.vstack([wanted - step @ last, wanted[1:], [wanted[0] - ends.mean(axis=0)]]))
    rows[5] += slopes[0] * rows[3] + slopes[1] * rows[4]
    expected = rows <= bounds
    for i in np.flatnonzero(~expected[5] & np.isfinite(wanted[0])):
        rest = stopping_place(*wanted[:, i].tolist(), *hardest[:, i].tolist())
        least, largest = min(ends[0, i], last[0, i]), max(ends[1, i], last[0, i])
        expected[5, i] = least <= min(wanted[0, i], rest) and max(wanted[0, i], rest) <= largest
    flags = flags_within(wanted, last, DT, bounds, slopes, ends, hardest)
    if flags is None:
        assert expected.all()
    else:
        np.testing.assert_array_equal(flags[:5], expected[:5])
        sound = np.isfinite(wanted[0])
        np.testing.assert_array_equal(flags[5][sound], expected[5][sound])
