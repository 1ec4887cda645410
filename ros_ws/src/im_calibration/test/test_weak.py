"""Few poses, much noise, many outliers: where a maximum of the likelihood alone runs away, or gates shut too early."""

from dataclasses import replace

import numpy as np
import pytest

from bench.calibration.score import deviations, score
from bench.calibration.synthetic import Design, make_scene
from im_calibration import calibrate
from im_calibration.design import unknowns_of
from im_calibration.estimation.gates import fit_with_gates
from im_calibration.estimation.search import best_explanation, first_explanation, unexplained
from im_calibration.estimation.start import affine_start
from im_calibration.estimation.unknowns import ParameterLayout

CROWDED = Design(poses=15, outlier_share=0.2, led_offset_prior_sd=0.05)


@pytest.mark.parametrize(
    "design",
    [
        Design(poses=20, led_offset_prior_sd=0.0, sigma_px=1.0),
        Design(poses=15, led_offset_prior_sd=0.05, missing_share=0.1),
    ],
    ids=["a pixel", "missing spots"],
)
def test_few_and_noisy_poses_do_not_lose_against_the_bound(design):
    found = score(design, range(20, 24))
    assert max(found.to_bound) < 1.1
    assert max(found.to_opencv) < 1.03
    assert np.mean(found.coverage) > 0.9
    assert found.verdicts == 0


def test_lens_priors_hardly_matter_where_data_are_good():
    problem = make_scene(Design(), 1).problem
    layout, calibration = ParameterLayout.of(problem), calibrate(problem)
    prior = layout.prior(unknowns_of(calibration, 1))
    by_data = np.linalg.inv(np.linalg.inv(calibration.covariance) - prior.lens_information)
    assert np.all(calibration.standard_deviations > 0.95 * np.sqrt(np.diag(by_data)))


def test_a_lens_far_from_the_priors_is_found_all_the_same():
    scene = make_scene(Design(cameras=1, sigma_px=0.05, sigma_m=1e-4), 2)
    true = scene.cameras[0]
    K = true.K.copy()
    K[0, 2] += 90.0
    wide = replace(true, K=K, D=np.array([-0.35, 0.15, 0.004, -0.004, 0.0]))
    points = scene.problem.positions + scene.problem.wrist_rotations @ scene.led_offset_error
    noise = np.random.default_rng(3).normal(0.0, 0.05, points[:, :2].shape)
    moved = replace(scene, cameras=(wide,))
    calibration = calibrate(replace(scene.problem, spots=(wide.project(points) + noise)[None]))
    assert np.all(np.abs(deviations(calibration, moved)) < 4.5 * calibration.standard_deviations)


def test_a_set_that_the_first_start_misses_is_found_and_no_start_explains_more():
    scene = make_scene(CROWDED, 1057)
    layout = ParameterLayout.of(scene.problem)
    first = first_explanation(scene.problem, layout)
    # whether the first start misses by itself is a matter of the last digits: here its gates have shut on half of all
    first = replace(first, used=first.used & (np.arange(len(scene.problem.positions)) < 7))
    best = best_explanation(scene.problem, layout, first)
    assert unexplained(best, scene.problem) < unexplained(first, scene.problem)
    assert not (scene.outliers & best.used).any()
    again = fit_with_gates(best.fit.unknowns, scene.problem, layout)
    assert unexplained(best, scene.problem) <= unexplained(again, scene.problem) + 1e-6


def test_the_affine_start_is_near_the_camera():
    scene = make_scene(Design(led_offset_prior_sd=0.0, outlier_share=0.1), 4)
    for camera, pixels in zip(scene.cameras, scene.problem.spots, strict=True):
        seen = ~np.isnan(pixels[:, 0])
        found = affine_start(scene.problem.positions[seen], pixels[seen], (640, 480), 5.0)
        assert found is not None
        intrinsics, rotation, translation = found
        assert 0.5 < intrinsics[0] / camera.K[0, 0] < 2.0
        assert np.trace(rotation @ camera.R_cam_base.T) > 1.0 + 2.0 * np.cos(0.2)
        assert 0.5 < translation[2] / camera.t_cam_base[2] < 2.0
