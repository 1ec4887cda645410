"""Recorded positions with noise: followed in nearly their time, not further off than allowed, or refused before."""

import numpy as np
import pytest

from im_core.errors import DataError
from im_mcs.planning.motions.noise import is_noisy

SECONDS, WAY_SHARE = 3.0, 0.6


def recorded(rig, way, rate_hz, noise, seed=1):
    """Times and positions of a smooth motion, as encoders with noise [rad or m] read them."""
    t = np.arange(1, round(SECONDS * rate_hz) + 1) / rate_hz
    x = t / SECONDS
    covered = WAY_SHARE * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    truth = rig.home + covered[:, None] * way
    return t, truth, truth + noise * np.random.default_rng(seed).standard_normal(truth.shape)


def ask(rig, times, q, **more):
    points = [{"time": time, "positions": row} for time, row in zip(times.tolist(), q.tolist(), strict=True)]
    return rig.request({"kind": "trajectory", "points": points} | more)


@pytest.mark.parametrize("rate_hz", [50, 200])
def test_noise_is_smoothed_and_the_motion_takes_its_time(rig, way, rate_hz):
    times, truth, q = recorded(rig, way, rate_hz, 1e-4)
    goal = ask(rig, times, q)
    rig.run()
    assert rig.code(goal) is None
    results = rig.results[goal][1]
    assert results["retimed"].startswith("noise of positions smoothed by up to 0.000")
    assert results["duration"] < 1.1 * SECONDS
    rig.check_motion()
    on_the_way = rig.q[:: len(rig.q) // 40]
    nearest = [np.abs(np.vstack([rig.home, truth]) - place).max(axis=1).min() for place in on_the_way]
    assert max(nearest) < 1e-3 + 0.01 * 50 / rate_hz  # and half a step of the recording


def test_a_path_tolerance_says_how_far(rig, way):
    times, _, q = recorded(rig, way, 50, 1e-4)
    rough = ask(rig, times, q, path_tolerance=[2e-4] * 9)
    rig.run()
    fault = rig.results[rough][0]
    assert isinstance(fault, DataError)
    assert "half of a path_tolerance" in fault.message
    assert "instead of 3.000 s" in fault.message
    assert not rig.trace[-1].v.any()


@pytest.mark.parametrize("rate_hz", [50, 200])
def test_more_noise_than_may_be_smoothed_is_refused_before_anything_moves(rig, way, rate_hz):
    times, _, q = recorded(rig, way, rate_hz, 3e-3)
    goal = ask(rig, times, q)
    rig.run()
    assert "the motion would take" in rig.results[goal][0].message
    np.testing.assert_array_equal(rig.trace[-1].q, rig.home)
    assert rig.tick < 200


def test_what_has_corners_or_jumps_of_acceleration_has_no_noise(rig, way):
    times, truth, _ = recorded(rig, way, 50, 0.0)
    ramp = rig.home + np.clip(times - 0.5, 0.0, 2.0)[:, None] * way
    for q in (truth, ramp, rig.home + np.abs(np.sin(3.0 * times))[:, None] * way):
        assert not is_noisy(times, q, rig.limits)
