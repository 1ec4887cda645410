"""Places of lines in drawn images."""

import numpy as np
import pytest
from scipy.special import erf

from im_cell.robot import load_cell
from im_vss.laser.line import line_peaks
from im_vss.settings import load_settings

SETTINGS = load_settings(load_cell())
SENSOR, GATES = SETTINGS.sensor, SETTINGS.laser.line
SHAPE = (120, 160)


def frames(centres, peak, sigma=1.0, seed=0):
    """A pair of frames with an upright line at `centres`, one a row [px]; NaN: none there."""
    rng, columns = np.random.default_rng(seed), np.arange(SHAPE[1])
    edges = (columns[None] - np.asarray(centres)[:, None]) / (np.sqrt(2.0) * sigma)
    half = 0.5 / (np.sqrt(2.0) * sigma)
    line = np.nan_to_num(peak * sigma * np.sqrt(2.0 * np.pi) * 0.5 * (erf(edges + half) - erf(edges - half)))
    off = np.full(SHAPE, 40.0)
    noisy = [mean + rng.normal(0.0, np.sqrt(SENSOR.analog_variance(mean))) for mean in (off + line, off)]
    return [np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in noisy]


def test_places_are_right_to_a_tenth_of_a_pixel_in_both_directions():
    centres = np.linspace(40.0, 75.0, SHAPE[0]) + 0.3
    on, off = frames(centres, 80.0)
    peaks = line_peaks(on, off, True, SENSOR, GATES)
    assert len(peaks.pixels) == SHAPE[0]
    error = peaks.pixels[:, 0] - centres[peaks.pixels[:, 1].astype(int)]
    assert abs(error.mean()) < 0.02
    assert error.std() < 0.1
    lying = line_peaks(np.ascontiguousarray(on.T), np.ascontiguousarray(off.T), False, SENSOR, GATES)
    np.testing.assert_allclose(lying.pixels[:, ::-1], peaks.pixels)
    assert np.median(peaks.brightness) == pytest.approx(75.0, rel=0.15)


def test_rows_without_light_give_nothing():
    centres = np.full(SHAPE[0], np.nan)
    centres[30:50] = 80.0
    peaks = line_peaks(*frames(centres, 80.0), True, SENSOR, GATES)
    assert sorted(peaks.pixels[:, 1]) == list(range(30, 50))
    assert peaks.rejected == {}
    for seed in range(20):
        assert len(line_peaks(*frames(np.full(SHAPE[0], np.nan), 80.0, seed=seed), True, SENSOR, GATES).pixels) == 0


def test_causes_are_counted():
    centres = np.full(SHAPE[0], 80.0)
    assert line_peaks(*frames(centres, 400.0), True, SENSOR, GATES).rejected == {"saturated": SHAPE[0]}
    assert line_peaks(*frames(centres - 79.0, 80.0), True, SENSOR, GATES).rejected == {
        "at the edge of the image": SHAPE[0]
    }
    (on, off), (other, _) = frames(centres, 80.0), frames(centres - 30.0, 80.0)
    both = np.maximum(on, other)
    assert line_peaks(both, off, True, SENSOR, GATES).rejected == {"more than one line in the row": SHAPE[0]}
