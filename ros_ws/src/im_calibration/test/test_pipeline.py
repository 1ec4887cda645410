"""The whole calibration: at the statistical limit, robust, honest about its errors, independent of order."""

from dataclasses import replace

import numpy as np
import pytest

from bench.calibration.score import cramer_rao
from bench.calibration.synthetic import Design, make_scene
from im_calibration import calibrate
from im_cell.calibration_error import evaluate

HARD = Design(outlier_share=0.15, missing_share=0.05, led_offset_prior_sd=0.05)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def errors(scene, calibration):
    points = scene.problem.workspace.grid()
    found = evaluate([camera.model for camera in calibration.cameras], scene.cameras, points)
    return found.triangulation_rms_mm, found.reprojection_rms_px


def bound(scene):
    found = cramer_rao(scene)
    return found.triangulation_rms_mm, found.reprojection_rms_px


def calibrated(design, seeds):
    scenes = [make_scene(design, seed) for seed in seeds]
    return [(scene, calibrate(scene.problem)) for scene in scenes]


@pytest.fixture(scope="module")
def clean():
    """Eight good data sets with their calibrations."""
    return calibrated(Design(), range(100, 108))


def check_errors(solved):
    found, bounds, predicted, reduced, missed = [], [], [], [], 0
    for scene, calibration in solved:
        assert calibration.success, calibration.message
        missed += int((scene.outliers & calibration.used & scene.problem.detected).sum())
        found.append(errors(scene, calibration))
        bounds.append(bound(scene))
        expected = calibration.expected
        predicted.append((expected.triangulation_rms_mm, expected.reprojection_rms_px))
        reduced.append(calibration.chi2_per_dof)
    for column in range(2):
        ours = rms([pair[column] for pair in found])
        # Some seeds scatter by a tenth; 1.3 is out of reach for a solver that loses more than a little.
        assert ours < 1.3 * rms([pair[column] for pair in bounds])
        assert rms([pair[column] for pair in predicted]) / 1.3 < ours < 1.3 * rms([pair[column] for pair in predicted])
    assert 0.85 < np.mean(reduced) < 1.1  # an error of the arm that may be, and is not, is counted in
    assert missed <= 1  # a stale position along the only camera's line of sight cannot be told from a good one


def test_errors_of_clean_data_are_at_the_bound_and_as_predicted(clean):
    check_errors(clean)


@pytest.mark.parametrize(
    "design",
    [
        HARD,
        Design(outlier_share=0.1, anisotropy=4.0, sigma_m=1e-3, joint_offset_prior_sd=0.005),
        Design(cameras=3, poses=30, outlier_share=0.15),
    ],
    ids=["outliers and unknown LED", "anisotropic and joint offsets", "three cameras"],
)
def test_errors_are_at_the_bound_and_as_predicted(design):
    check_errors(calibrated(design, range(100, 104)))


def test_intervals_cover_the_truth(clean):
    inside = []
    for scene, calibration in clean:
        for estimate, true in zip(calibration.cameras, scene.cameras, strict=True):
            model, sd = estimate.model, estimate.standard_deviations
            deviations = np.concatenate(
                (
                    np.diag(model.K - true.K)[:2] / sd[:2],
                    (model.K - true.K)[:2, 2] / sd[2:4],
                    (model.D - true.D)[:4] / sd[4:8],
                    (model.t_cam_base - true.t_cam_base) / sd[11:],
                )
            )
            inside.append(np.abs(deviations) < 1.96)
        led = np.sqrt(np.diag(calibration.covariance)[28:31])
        assert np.all(np.abs(calibration.led_offset_error - scene.led_offset_error) < 4.5 * led)
    assert 0.90 < np.mean(inside) < 0.99


def test_the_same_problem_gives_the_same_bits_in_any_order_of_the_poses():
    scene = make_scene(HARD, 7)
    problem = scene.problem
    order = np.random.default_rng(1).permutation(len(problem.positions))
    shuffled = replace(
        problem,
        positions=problem.positions[order],
        position_covariances=problem.position_covariances[order],
        wrist_rotations=problem.wrist_rotations[order],
        spots=problem.spots[:, order],
        spot_covariances=problem.spot_covariances[:, order],
        pose_names=tuple(problem.pose_names[i] for i in order),
    )
    one, again, other = calibrate(problem), calibrate(problem), calibrate(shuffled)
    np.testing.assert_array_equal(one.covariance, again.covariance)
    assert (one.chi2, one.message) == (again.chi2, again.message)
    for a, b in zip(one.cameras, other.cameras, strict=True):
        np.testing.assert_array_equal(a.model.K, b.model.K)
        np.testing.assert_array_equal(a.model.R_cam_base, b.model.R_cam_base)
        np.testing.assert_array_equal(a.covariance, b.covariance)
    np.testing.assert_array_equal(one.used[:, order], other.used)
    assert {(r.pose, r.camera) for r in one.rejections} == {(r.pose, r.camera) for r in other.rejections}


def test_parts_of_the_data_predict_each_other_as_expected(clean):
    checks = [calibration.checks for _, calibration in clean]
    assert all(each.far_half_p_value > 1e-3 for each in checks)
    assert 0.75 < rms([c.held_out_px for c in checks]) / rms([c.held_out_expected_px for c in checks]) < 1.33


def test_halves_that_are_too_small_are_not_compared():
    checks = calibrate(make_scene(Design(poses=10), 36).problem).checks
    assert np.isnan(checks.far_half_px)
    assert checks.held_out_px > 0.0


def test_one_camera_alone_is_calibrated_too():
    scene = make_scene(Design(cameras=1), 10)
    calibration = calibrate(scene.problem)
    assert calibration.success, calibration.message
    assert np.isnan(calibration.expected.triangulation_rms_mm)
    assert "px RMS" in calibration.message


def test_exact_positions_are_allowed():
    scene = make_scene(Design(sigma_m=1e-9), 11)
    exact = replace(scene.problem, position_covariances=np.zeros((40, 3, 3)))
    calibration = calibrate(exact)
    assert calibration.success, calibration.message
    assert calibration.cameras[0].model.K[0, 0] == pytest.approx(scene.cameras[0].K[0, 0], rel=0.01)


def test_rejections_name_pose_and_camera():
    scene = make_scene(Design(), 12)
    spots, positions = scene.problem.spots.copy(), scene.problem.positions.copy()
    spots[1, 3] += [4.0, 0.0]
    positions[8] += [0.05, 0.0, 0.0]
    names = tuple(f"p{i}" for i in range(40))
    calibration = calibrate(replace(scene.problem, spots=spots, positions=positions, pose_names=names))
    assert calibration.success, calibration.message
    assert ("p3", "camera_1") in {(r.pose, r.camera) for r in calibration.rejections}
    assert ("p8", "") in {(r.pose, r.camera) for r in calibration.rejections}
    assert all(r.sigmas > 3.0 and "sigma" in r.reason for r in calibration.rejections)
