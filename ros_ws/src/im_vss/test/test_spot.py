"""The spot's centre, its covariance, and the causes of failure."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_cell.psf import amplitude_to_flux, pixel_derivatives, pixel_integrals
from im_cell.sensor import SensorNoise
from im_vss.spot import SpotGates, find_spot

NOISE = SensorNoise(gain=10.0, read_noise=28.0, black_level=8.0)
GATES = SpotGates(
    sigma_expected=1.2,
    sigma_low=0.6,
    sigma_high=3.5,
    detection_snr=7.0,
    faint_snr=5.6,
    chi2_per_dof=2.0,
    saturated_pixels=12,
    rival_ratio=0.35,
    edge=3.0,
)
SHAPE = (48, 64)
LAMPS = [(30.3, 21.8, 150.0, 1.2)]


def spot(u, v, amplitude, sigma, shape=SHAPE):
    """Noise-free image of a spot, by the model."""
    flux = amplitude_to_flux(amplitude, sigma)
    along_u = pixel_integrals(u, sigma, np.arange(shape[1], dtype=float))
    along_v = pixel_integrals(v, sigma, np.arange(shape[0], dtype=float))
    return flux * np.outer(along_v, along_u)


def frame(rng, mean, read_noise=NOISE.read_noise):
    """An exposure: Poisson photons, Gaussian read noise, quantisation."""
    electrons = rng.poisson((mean - NOISE.black_level) * NOISE.gain) + rng.normal(0.0, read_noise, mean.shape)
    return np.clip(np.rint(electrons / NOISE.gain + NOISE.black_level), 0, 255).astype(np.uint8)


def background(rng, shape=SHAPE):
    """A room that is not uniform."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    return 50.0 + 25.0 * np.sin(columns / 9.0 + rng.uniform(0, 6)) * np.cos(rows / 7.0)


def pair(rng, lamps, shape=SHAPE):
    """On and off frames of some lamps (u, v, amplitude, sigma)."""
    room = background(rng, shape)
    return frame(rng, room + sum(spot(*lamp, shape) for lamp in lamps)), frame(rng, room)


def test_centre_is_unbiased_precise_and_its_covariance_honest():
    rng = np.random.default_rng(1)
    errors, normalised, deviations = [], [], []
    for _ in range(400):
        u, v = rng.uniform(12, 50), rng.uniform(12, 36)
        finding = find_spot(*pair(rng, [(u, v, rng.uniform(110, 170), rng.uniform(1.05, 1.4))]), NOISE, GATES)
        assert finding.spot is not None, finding.cause
        error = np.array([finding.spot.u - u, finding.spot.v - v])
        errors.append(error)
        deviations.append(np.sqrt(np.diag(finding.spot.covariance)))
        normalised.append(error @ np.linalg.solve(finding.spot.covariance, error) / 2.0)
    assert np.mean(normalised) == pytest.approx(1.0, abs=4.0 / np.sqrt(400))
    assert np.abs(np.mean(errors, axis=0)).max() < 4.0 * 0.05 / np.sqrt(400)
    assert 0.015 < np.mean(deviations) < 0.05


def test_no_spot_in_frames_of_noise():
    rng = np.random.default_rng(2)
    shape = (480, 640)
    room = background(rng, shape).astype(np.float32)
    deviation = np.sqrt(NOISE.analog_variance(room))
    for _ in range(25):
        on, off = (
            np.clip(np.rint(room + deviation * rng.standard_normal(shape, dtype=np.float32)), 0, 255).astype(np.uint8)
            for _ in range(2)
        )
        finding = find_spot(on, off, NOISE, GATES)
        assert finding.spot is None
        assert "no light seen" in finding.cause
        assert finding.snr < GATES.faint_snr


@pytest.mark.parametrize(
    ("lamps", "cause"),
    [
        ([], "no light seen"),
        ([(30, 20, 14.0, 1.2)], "too faint"),
        ([(30, 20, 900.0, 2.0)], "saturated: "),
        ([(20, 20, 150.0, 1.2), (45, 30, 120.0, 1.2)], "several candidates: "),
        ([(30, 20, 150.0, 5.0)], "wrong s"),
        ([(1.2, 20, 150.0, 1.2)], "edge of the image"),
    ],
)
def test_cause_when_not_found(lamps, cause):
    finding = find_spot(*pair(np.random.default_rng(3), lamps), NOISE, GATES)
    assert finding.spot is None
    assert cause in finding.cause


def test_weak_reflection_does_not_hide_the_spot():
    finding = find_spot(*pair(np.random.default_rng(4), [*LAMPS, (50, 36, 35.0, 1.2)]), NOISE, GATES)
    assert finding.spot is not None
    assert (finding.spot.u, finding.spot.v) == pytest.approx((30.3, 21.8), abs=0.2)
    assert len(finding.candidates) == 2


def test_few_saturated_pixels_do_no_harm():
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(60):
        u, v = rng.uniform(25, 35, 2)
        finding = find_spot(*pair(rng, [(u, v, 360.0, 1.2)]), NOISE, GATES)
        assert finding.spot is not None, finding.cause
        assert finding.spot.saturated > 0
        errors.append((finding.spot.u - u, finding.spot.v - v))
    assert np.sqrt(np.mean(np.square(errors))) < 0.03


def flat(u, v, half_axes, turn, fine=8):
    """Image of an evenly bright ellipse, a little out of focus, with a peak of 130."""
    rows, columns = (np.mgrid[: SHAPE[0] * fine, : SHAPE[1] * fine] + 0.5) / fine - 0.5
    along = (columns - u) * np.cos(turn) + (rows - v) * np.sin(turn)
    across = (rows - v) * np.cos(turn) - (columns - u) * np.sin(turn)
    sharp = ((along / half_axes[0]) ** 2 + (across / half_axes[1]) ** 2 < 1.0).astype(float)
    blurred = cv2.GaussianBlur(sharp, (0, 0), 0.8 * fine).reshape(SHAPE[0], fine, SHAPE[1], fine).mean(axis=(1, 3))
    return 130.0 * blurred / blurred.max()


def smeared(u, v, length, turn):
    """Image of a light that moves while it is exposed."""
    places = np.linspace(-length / 2.0, length / 2.0, 33)
    return sum(spot(u + np.cos(turn) * s, v + np.sin(turn) * s, 200.0, 1.2) for s in places) / 33.0


@pytest.mark.parametrize("noisier", [1.0, 2.0])
@pytest.mark.parametrize(
    "image",
    [
        lambda u, v, turn: spot(u, v, 130.0, 1.2),
        lambda u, v, turn: flat(u, v, (3.0, 3.0), turn),
        lambda u, v, turn: flat(u, v, (4.0, 2.0), turn),
        lambda u, v, turn: smeared(u, v, 4.0, turn),
    ],
    ids=["gaussian", "disc", "ellipse", "smear"],
)
def test_spots_of_other_shapes_and_noisier_frames_have_their_centre(image, noisier):
    rng, normalised = np.random.default_rng(11), []
    for _ in range(40):
        (u, v), room = rng.uniform((14, 14), (50, 34)), background(rng)
        lit = room + image(u, v, rng.uniform(0.0, np.pi))
        read = noisier * NOISE.read_noise
        if (found := find_spot(frame(rng, lit, read), frame(rng, room, read), NOISE, GATES).spot) is not None:
            error = np.array([found.u - u, found.v - v])
            normalised.append(error @ np.linalg.solve(found.covariance, error) / 2.0)
    assert len(normalised) >= 38
    assert 0.5 < np.mean(normalised) < 1.7


def test_a_camera_that_shakes_shows_no_light():
    rng = np.random.default_rng(5)
    for _ in range(60):
        texture = np.clip(background(rng) + 120.0 * cv2.GaussianBlur(rng.normal(size=SHAPE), (0, 0), 1.5), 10, 240)
        move = np.float32([[1, 0, rng.uniform(-0.5, 0.5)], [0, 1, rng.uniform(-0.5, 0.5)]])
        moved = cv2.warpAffine(texture, move, SHAPE[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        moved = np.clip(moved, 10, 240)
        assert find_spot(frame(rng, moved), frame(rng, texture), NOISE, GATES).spot is None


@given(st.floats(-3, 3), st.floats(0.4, 4.0))
@settings(max_examples=40, deadline=None)
def test_derivatives_of_the_spot_model(centre, sigma):
    pixels, step = np.arange(-8.0, 9.0), 1e-6
    by_centre, by_sigma = pixel_derivatives(centre, sigma, pixels)
    upper, lower = pixel_integrals(centre + step, sigma, pixels), pixel_integrals(centre - step, sigma, pixels)
    np.testing.assert_allclose(by_centre, (upper - lower) / (2 * step), atol=1e-8)
    upper, lower = pixel_integrals(centre, sigma + step, pixels), pixel_integrals(centre, sigma - step, pixels)
    np.testing.assert_allclose(by_sigma, (upper - lower) / (2 * step), atol=1e-8)
