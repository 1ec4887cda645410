"""Optimal design: what a further pose is said to tell is what the whole information matrix says."""

import numpy as np
import pytest

from bench.calibration.synthetic import Design, make_scene
from im_calibration import calibrate
from im_calibration.design import PoseDesign, unknowns_of
from im_calibration.estimation.residuals import linearise
from im_calibration.estimation.unknowns import ParameterLayout
from im_calibration.judgement.expected import expected_error

FIRST, POOL, LOOKS = np.arange(14), np.arange(14, 34), 3


@pytest.fixture(scope="module")
def known():
    whole = make_scene(Design(poses=34), 2).problem
    calibration, pool = calibrate(whole.taking(FIRST)), whole.taking(POOL)
    unknowns, layout = unknowns_of(calibration, len(POOL)), ParameterLayout.of(pool)
    return calibration, pool, unknowns, linearise(unknowns, pool, layout, pool.detected)


def gained(line, pose, looks):
    return looks * line.jacobians[pose].T @ np.linalg.inv(line.covariances[pose]) @ line.jacobians[pose]


def test_the_best_pose_has_the_largest_determinant_for_its_time(known):
    calibration, pool, unknowns, line = known
    seconds = np.linspace(1.0, 2.0, len(POOL))
    before = np.linalg.inv(calibration.covariance)
    gains = [np.linalg.slogdet(before + gained(line, k, LOOKS))[1] for k in range(len(POOL))]
    best = np.argmax((np.array(gains) - np.linalg.slogdet(before)[1]) / seconds)
    design = PoseDesign(pool, unknowns, calibration.covariance, LOOKS)
    assert design.best(seconds, np.ones(len(POOL), dtype=bool)) == best
    assert design.best(seconds, np.arange(len(POOL)) != best) != best
    assert design.best(seconds, np.zeros(len(POOL), dtype=bool)) is None


def test_a_pose_lowers_the_expected_error_as_its_information_does(known):
    calibration, pool, unknowns, line = known
    design = PoseDesign(pool, unknowns, calibration.covariance, LOOKS)
    assert design.expected_mm == pytest.approx(calibration.expected.triangulation_rms_mm, rel=1e-9)
    design.add(4, 2)
    covariance = np.linalg.inv(np.linalg.inv(calibration.covariance) + gained(line, 4, 2))
    found = expected_error(unknowns, covariance, pool.image_sizes, pool.workspace)
    assert design.expected_mm == pytest.approx(found.triangulation_rms_mm, rel=1e-4)
