"""The bars of spot finding, on a few seeded trials; ``python -m bench.spot`` has the many."""

import numpy as np
import pytest

from bench.spot.trials import Lamp, bound, count_false, expose, room, score_spots, spot_image
from im_cell.psf import amplitude_to_flux, pixel_integrals
from im_cell.robot import load_cell
from im_vss.settings import load_settings
from im_vss.spot import SearchDisc, find_spot

SETTINGS = load_settings(load_cell())
NOISE, GATES = SETTINGS.sensor, SETTINGS.spot
SHAPE = (80, 100)


@pytest.mark.parametrize(("peaks", "widths"), [((40.0, 90.0), (1.0, 1.4)), ((90.0, 170.0), (1.0, 2.6))])
def test_unsaturated_spots_are_at_the_bound(peaks, widths):
    score = score_spots(1, 300, peaks, widths, NOISE, GATES)
    assert score.found == 1.0
    assert score.ratio < 1.15
    assert score.nees == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("peaks", [(260.0, 400.0), (400.0, 1200.0)])
def test_saturated_spots(peaks):
    score = score_spots(2, 300, peaks, (1.0, 1.5), NOISE, GATES)
    assert score.found == 1.0
    assert score.rms_px < 0.03
    assert score.nees == pytest.approx(1.0, abs=0.3)


def test_no_false_spot():
    assert count_false(3, 20, NOISE, GATES) == 0


def test_two_ways_to_draw_a_spot_agree_and_the_bound_falls_with_light():
    lamp = Lamp(30.3, 21.7, 150.0, 1.2)
    across = pixel_integrals(lamp.u, lamp.sigma, np.arange(100.0))
    down = pixel_integrals(lamp.v, lamp.sigma, np.arange(80.0))
    flux = amplitude_to_flux(lamp.amplitude, lamp.sigma)
    np.testing.assert_allclose(spot_image(lamp, SHAPE), flux * np.outer(down, across), atol=0.05)
    ground = np.full(SHAPE, 50.0)
    bright = Lamp(lamp.u, lamp.v, 200.0, lamp.sigma)
    assert np.trace(bound(bright, ground, NOISE)) < np.trace(bound(lamp, ground, NOISE))


def pair(*lamps):
    rng = np.random.default_rng(4)
    ground = room(rng, SHAPE)
    return expose(rng, ground + sum(spot_image(lamp, SHAPE) for lamp in lamps), NOISE), expose(rng, ground, NOISE)


def test_up_to_three_candidates_are_handed_on_brightest_first():
    peaks = (150.0, 130.0, 110.0, 90.0)
    lamps = [Lamp(15.0 + 22.0 * k, 40.0, peak, 1.2) for k, peak in enumerate(peaks)]
    finding = find_spot(*pair(*lamps), NOISE, GATES)
    assert finding.spot is None
    assert "several candidates" in finding.cause
    assert [round(candidate.u) for candidate in finding.candidates] == [15, 37, 59]


def test_a_predicted_region_leaves_other_lights_out():
    lamps = Lamp(20.0, 20.0, 150.0, 1.2), Lamp(75.0, 60.0, 160.0, 1.2)
    finding = find_spot(*pair(*lamps), NOISE, GATES, SearchDisc(22.0, 21.0, 15.0))
    assert finding.spot is not None, finding.cause
    assert (finding.spot.u, finding.spot.v) == pytest.approx((20.0, 20.0), abs=0.2)
    missed = find_spot(*pair(lamps[1]), NOISE, GATES, SearchDisc(22.0, 21.0, 15.0))
    assert missed.spot is None
    assert missed.cause == "no light seen: it is off, blocked or out of view; searched within 15 px of (22, 21) px"


@pytest.mark.parametrize(
    ("u", "v", "radius"), [(5.0, 4.0, 6.0), (95.0, 77.0, 9.0), (50.0, 40.0, 12.0), (50.0, 40.0, 300.0)]
)
def test_a_region_changes_no_digit_of_what_is_in_it(u, v, radius):
    frames = pair(Lamp(u + 1.3, v - 0.6, 150.0, 1.2))
    everywhere, there = (find_spot(*frames, NOISE, GATES, region) for region in (None, SearchDisc(u, v, radius)))
    assert everywhere.snr > GATES.detection_snr
    assert repr((there.spot, there.snr, there.refused)) == repr((everywhere.spot, everywhere.snr, everywhere.refused))


def test_a_region_outside_the_frame_has_no_light():
    frames = pair(Lamp(50.0, 40.0, 150.0, 1.2))
    assert find_spot(*frames, NOISE, GATES, SearchDisc(-400.0, 40.0, 12.0)).spot is None
