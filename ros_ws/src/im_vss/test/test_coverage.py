"""Stated covariances hold the truth over the whole chain: cameras are calibrated from noise, then used."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from bench.calibration.synthetic import Design
from bench.vss import coverage
from bench.vss.coverage import MEASUREMENTS, calibrated, lines

SEEDS = 6
BY_CHANCE = 1e-4


@pytest.fixture(scope="module")
def cameras():
    return [calibrated(seed, Design()) for seed in range(SEEDS)]


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_the_truth_is_as_far_off_as_stated(cameras, name):
    """A sum of squared distances, one a seed, is chi-square; the pixels' part of the covariance alone is not enough."""
    measured = [MEASUREMENTS[name](each) for each in cameras]
    total, freedom = (sum(column) for column in zip(*measured, strict=True))
    assert chi2.ppf(BY_CHANCE, freedom) < total < chi2.ppf(1.0 - BY_CHANCE, freedom)


def test_cameras_count(cameras):
    """The calibration is most of what is off: without it the same distances are far too large."""
    distances = []
    for each in cameras:
        place = np.array([0.1, 0.2, 0.9])
        point = each.look(place)
        error = point.position - place
        distances.append(error @ np.linalg.solve(point.by_spots, error))
    assert sum(distances) > chi2.ppf(1.0 - BY_CHANCE, 3 * SEEDS)


def test_gross_errors_are_told_from_what_the_cameras_are_off(cameras, monkeypatch):
    """Exactly the spots that were moved are left out, and cameras that are as good as they say are no misfit."""
    calibrate, found = coverage.calibrate_laser, []

    def spoilt(sheet, spots, known, gates):
        for wrong in (3, 11, 17):
            point = spots[wrong].point
            moved = replace(point, position=point.position + np.array([0.02, -0.05, 0.03]))
            spots[wrong] = replace(spots[wrong], point=moved)
        found.append(calibrate(sheet, spots, known, gates))
        return found[-1]

    monkeypatch.setattr(coverage, "calibrate_laser", spoilt)
    for each in cameras:
        coverage.laser(each)
    assert [np.flatnonzero(~each.used).tolist() for each in found] == [[3, 11, 17]] * SEEDS
    assert [each.verdicts for each in found] == [()] * SEEDS


def test_the_bench_counts_what_is_inside():
    found = lines(seeds=1)
    assert [line.value in (0.0, 1.0) for line in found] == [True] * 6
