"""Stated covariances hold the truth over the whole chain: cameras are calibrated from noise, then used."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from bench.calibration.synthetic import Design
from bench.vss import coverage
from bench.vss.coverage import MEASUREMENTS, calibrated, lines
from im_cell.camera_model import PARAMETERS

SEEDS = 4
BY_CHANCE = 1e-4


@pytest.fixture(scope="module")
def calibrations():
    return [calibrated(seed, Design()) for seed in range(SEEDS)]


@pytest.fixture
def cameras(calibrations):
    """The same draws for each test, whichever came before."""
    return [replace(each, rng=np.random.default_rng((seed, 3))) for seed, each in enumerate(calibrations)]


def squared_distances(name, cameras):
    """Their sum over the seeds, one of each, and its degrees of freedom: chi-square if the covariances are right."""
    return (sum(column) for column in zip(*[MEASUREMENTS[name](each) for each in cameras], strict=True))


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_the_truth_is_as_far_off_as_stated(cameras, name):
    total, freedom = squared_distances(name, cameras)
    assert chi2.ppf(BY_CHANCE, freedom) < total < chi2.ppf(1.0 - BY_CHANCE, freedom)


def test_without_the_cameras_it_is_far_too_far_off(cameras, monkeypatch):
    monkeypatch.setattr(coverage.Measured, "known", lambda self, *names: np.zeros((len(PARAMETERS), len(PARAMETERS))))
    total, freedom = squared_distances("fiducial", cameras)
    assert total > 2.0 * chi2.ppf(1.0 - BY_CHANCE, freedom)


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
    for each in cameras[:2]:
        coverage.laser(each)
    assert [np.flatnonzero(~each.used).tolist() for each in found] == [[3, 11, 17]] * 2
    assert [each.verdicts for each in found] == [()] * 2


def test_the_bench_counts_what_is_inside():
    found = lines(seeds=1)
    assert [line.value in (0.0, 1.0) for line in found] == [True] * 9
