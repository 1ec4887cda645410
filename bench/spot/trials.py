"""Seeded trials of the spot finder on frames whose truth is known."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from im_cell.sensor import SensorNoise
from im_vss.spot import SpotGates, find_spot

Array = NDArray[np.float64]
Frame = NDArray[np.uint8]

_FINE = 15
_PATCH = (41, 41)


@dataclass(frozen=True)
class Lamp:
    """A spot as it truly is: centre, peak above the background [DN], standard deviation [px]."""

    u: float
    v: float
    amplitude: float
    sigma: float


@dataclass(frozen=True)
class Score:
    """What many trials gave.

    Attributes:
        found: Share of the spots that were found.
        rms_px: RMS of the centres' errors, of both axes together, an axis [px].
        bound_px: The same of the Cramer-Rao bound [px].
        nees: Mean squared error in units of the stated covariance, an axis: 1 if the covariance is right [-].
    """

    found: float
    rms_px: float
    bound_px: float
    nees: float

    @property
    def ratio(self) -> float:
        """RMS over the bound [-]."""
        return self.rms_px / self.bound_px


def spot_image(lamp: Lamp, shape: tuple[int, int]) -> Array:
    """Expected light of a spot on each pixel, integrated over the pixel on a fine grid, shape `shape` [DN]."""
    fine = (np.arange(_FINE) + 0.5) / _FINE - 0.5

    def along(centre: float, count: int) -> Array:
        places = np.arange(count)[:, None] + fine - centre
        return np.asarray(np.exp(-0.5 * (places / lamp.sigma) ** 2).mean(axis=1))

    return np.asarray(lamp.amplitude * np.outer(along(lamp.v, shape[0]), along(lamp.u, shape[1])))


def expose(rng: np.random.Generator, mean: Array, noise: SensorNoise) -> Frame:
    """A frame of expected values, shape (h, w) [DN]: Poisson photons, Gaussian read noise, quantisation, saturation."""
    electrons = rng.poisson(np.maximum(mean - noise.black_level, 0.0) * noise.gain)
    read = rng.normal(0.0, noise.read_noise, mean.shape)
    return np.clip(np.rint((electrons + read) / noise.gain + noise.black_level), 0, noise.saturation).astype(np.uint8)


def room(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    """A background that is not uniform, shape `shape` [DN]."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    phase = rng.uniform(0.0, 6.0, 2)
    return np.asarray(50.0 + 25.0 * np.sin(columns / 19.0 + phase[0]) * np.cos(rows / 17.0 + phase[1]))


def bound(lamp: Lamp, background: Array, noise: SensorNoise) -> Array:
    """Cramer-Rao bound of the centre from a pair of frames, shape (2, 2) [px^2].

    Peak, width and level of the spot are unknown too. Fisher information of Gaussian pixels whose variance is known and
    that say no more than "at least" from saturation on. Source: S.M. Kay, "Fundamentals of Statistical Signal
    Processing", 3.9.
    """
    theta = np.array([lamp.u, lamp.v, lamp.amplitude, lamp.sigma, 0.0])

    def mean(values: Array) -> Array:
        u, v, amplitude, sigma, level = values
        shape = (background.shape[0], background.shape[1])
        return np.asarray(background + level + spot_image(Lamp(u, v, amplitude, sigma), shape))

    on = mean(theta)
    weight = information(on, background, noise)
    steps = np.array([1e-3, 1e-3, 1e-2, 1e-4, 1e-2])
    slopes = np.stack([(mean(theta + d) - mean(theta - d)).ravel() / (2.0 * d.sum()) for d in np.diag(steps)])
    return np.asarray(np.linalg.inv((slopes * weight.ravel()) @ slopes.T)[:2, :2])


def information(on: Array, off: Array, noise: SensorNoise) -> Array:
    """Fisher information of the differences of pixels about their means, one of which may saturate [1/DN^2].

    Source: T. Amemiya, "Regression analysis when the dependent variable is truncated normal", 1973, (3.2).

    Args:
        on: Expected values with the light, of any shape [DN].
        off: Expected values without it [DN].
        noise: Sensor.
    """
    variance = noise.variance(on) + noise.variance(off)
    room_left = (noise.saturation - 0.5 - on) / np.sqrt(variance)
    density = norm.pdf(room_left)
    mills = np.exp(norm.logpdf(room_left) - norm.logsf(room_left))
    return np.asarray((norm.cdf(room_left) + density * (mills - room_left)) / variance)


def score_spots(
    seed: int, trials: int, amplitude: tuple[float, float], sigma: tuple[float, float], noise: SensorNoise,
    gates: SpotGates,
) -> Score:  # fmt: skip
    """Find spots of random place, peak [DN] and width [px] in pairs of frames.

    Args:
        seed: Seed of everything random.
        trials: How many.
        amplitude: Range of the peaks [DN].
        sigma: Range of the widths [px].
        noise: Sensor.
        gates: As the Services use them.
    """
    rng = np.random.default_rng(seed)
    squares, bounds, normalised = [], [], []
    for _ in range(trials):
        centre = 20.0 + rng.uniform(-0.5, 0.5, 2)
        lamp = Lamp(float(centre[0]), float(centre[1]), float(rng.uniform(*amplitude)), float(rng.uniform(*sigma)))
        background = room(rng, _PATCH)
        on = expose(rng, background + spot_image(lamp, _PATCH), noise)
        finding = find_spot(on, expose(rng, background, noise), noise, gates)
        if finding.spot is None:
            continue
        error = np.array([finding.spot.u, finding.spot.v]) - centre
        squares.append(error @ error / 2.0)
        bounds.append(np.trace(bound(lamp, background, noise)) / 2.0)
        normalised.append(error @ np.linalg.solve(finding.spot.covariance, error) / 2.0)
    if not squares:
        return Score(0.0, np.inf, np.inf, np.inf)
    return Score(
        len(squares) / trials, float(np.sqrt(np.mean(squares))), float(np.sqrt(np.mean(bounds))),
        float(np.mean(normalised)),
    )  # fmt: skip


def count_false(seed: int, frames: int, noise: SensorNoise, gates: SpotGates) -> int:
    """How many of some pairs of whole frames without a light are said to show one."""
    rng = np.random.default_rng(seed)
    background = room(rng, (480, 640)).astype(np.float32)
    deviation = np.sqrt(noise.analog_variance(background))
    false = 0
    for _ in range(frames):
        pair = (background + deviation * rng.standard_normal(background.shape, dtype=np.float32) for _ in range(2))
        on, off = (np.clip(np.rint(frame), 0, noise.saturation).astype(np.uint8) for frame in pair)
        false += find_spot(on, off, noise, gates).spot is not None
    return false
