"""Saturated pixels say "at least this bright": the fit against a likelihood maximised by SciPy, and the bound."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import norm

from bench.spot.trials import Lamp, bound, expose, information, room, spot_image
from im_cell.psf import pixel_integrals
from im_cell.robot import load_cell
from im_vss.settings import load_settings
from im_vss.spot import fit_spot

NOISE = load_settings(load_cell()).sensor
SHAPE = (41, 41)
HALF = 6
LAMPS = [Lamp(20.3, 19.8, 330.0, 1.2), Lamp(19.7, 20.4, 1100.0, 1.4), Lamp(20.1, 20.2, 900.0, 2.4)]


def pair(rng, lamp):
    ground = room(rng, SHAPE)
    return expose(rng, ground + spot_image(lamp, SHAPE), NOISE), expose(rng, ground, NOISE)


def log_likelihood(theta, on, off, deviation):
    """Of (u, v, flux, sigma, background) in the window around the middle, deviations given."""
    u, v, flux, sigma, offset = theta
    area = np.s_[20 - HALF : 21 + HALF, 20 - HALF : 21 + HALF]
    pixels = np.arange(20.0 - HALF, 21.0 + HALF)
    mean = offset + flux * np.outer(pixel_integrals(v, sigma, pixels), pixel_integrals(u, sigma, pixels))
    ground = off[area].astype(float)
    exact = norm.logpdf(on[area] - ground, mean, deviation)
    at_least = norm.logsf(NOISE.saturation - 0.5 - ground, mean, deviation)
    return float(np.where(on[area] < NOISE.saturation, exact, at_least).sum())


def deviation_of(theta, off):
    """Of the differences, as the noise model says for a spot on the mean of 3 x 3 pixels without it."""
    u, v, flux, sigma, offset = theta
    pixels = np.arange(20.0 - HALF, 21.0 + HALF)
    spot = flux * np.outer(pixel_integrals(v, sigma, pixels), pixel_integrals(u, sigma, pixels)) + offset
    area = off[20 - HALF : 21 + HALF, 20 - HALF : 21 + HALF].astype(float)
    padded = np.pad(area, 1, mode="edge")
    ground = sum(padded[i : i + 13, j : j + 13] for i in range(3) for j in range(3)) / 9.0
    return np.sqrt(NOISE.variance(ground) + NOISE.variance(ground + np.maximum(spot, 0.0)))


@pytest.mark.parametrize("lamp", LAMPS)
def test_the_centre_is_the_likeliest_and_its_covariance_the_curvature(lamp):
    on, off = pair(np.random.default_rng(3), lamp)
    fit = fit_spot(on, off, (20, 20), 1.3, NOISE)
    assert fit.converged
    assert fit.saturated > 0
    theta = np.array([fit.u, fit.v, fit.amplitude * 2.0 * np.pi * fit.sigma**2, fit.sigma, 0.0])
    scale = np.array([0.01, 0.01, 0.01 * theta[2], 0.01, 1.0])
    for _ in range(3):  # the deviations follow the spot, as in the fit
        deviation = deviation_of(theta, off)
        found = minimize(
            lambda x, at=theta, sd=deviation: -log_likelihood(at + scale * x, on, off, sd), np.zeros(5), method="BFGS"
        )
        theta = theta + scale * found.x
    assert theta[:2] == pytest.approx([fit.u, fit.v], abs=2e-4)
    assert theta[3] == pytest.approx(fit.sigma, abs=1e-3)
    steps = np.diag([2e-3, 2e-3, 2e-3 * theta[2], 2e-3, 0.2])

    def at(*moves):
        return log_likelihood(theta + sum(moves), on, off, deviation)

    curvature = np.array(
        [[at(p, q) - at(p, -q) - at(-p, q) + at(-p, -q) for q in steps] for p in steps]
    ) / (-4.0 * np.outer(steps.diagonal(), steps.diagonal()))  # fmt: skip
    expected = np.linalg.inv(curvature).diagonal()[:2]
    np.testing.assert_allclose(np.sqrt(fit.covariance.diagonal()), np.sqrt(expected), rtol=0.02)


def test_the_bound_is_the_mean_square_of_the_score():
    """A pixel on a flat ground whose only unknown is its mean: by sampling."""
    rng = np.random.default_rng(4)
    mean, ground = 252.0, 60.0
    deviation = np.sqrt(NOISE.variance(np.array(mean)) + NOISE.variance(np.array(ground)))
    drawn = rng.normal(mean, deviation, 400_000)
    edge = NOISE.saturation - 0.5
    margin = (mean - edge) / deviation
    score = np.where(drawn < edge, (drawn - mean) / deviation**2, norm.pdf(margin) / norm.cdf(margin) / deviation)
    lamp, flat = Lamp(20.0, 20.0, 150.0, 1.2), np.full(SHAPE, ground)
    stated = float(information(np.array(mean), np.array(ground), NOISE))
    assert stated == pytest.approx(float(np.mean(score**2)), rel=0.01)
    brighter = Lamp(20.0, 20.0, 4000.0, 1.2)
    assert np.trace(bound(brighter, flat, NOISE)) < np.trace(bound(lamp, flat, NOISE))
