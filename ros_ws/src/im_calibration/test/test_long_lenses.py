"""Long lenses and foreign units: what counts is what terms do in the image, not their numbers."""

from dataclasses import replace

import numpy as np
import pytest

from bench.calibration.lenses import LensDesign, make_lens_scene
from bench.calibration.opencv import opencv_cameras
from bench.calibration.score import errors
from bench.calibration.synthetic import Design, make_scene
from im_calibration import calibrate
from im_calibration.design import unknowns_of
from im_calibration.estimation.unknowns import ParameterLayout
from im_cell.calibration_error import rms


@pytest.mark.parametrize(("view", "poses"), [(6.0, 40), (9.0, 15), (14.0, 25)])
def test_a_long_lens_is_as_good_as_predicted_and_no_worse_than_opencv(view, poses):
    found, expected, opencv = [], [], []
    for seed in range(400, 405):
        scene = make_lens_scene(LensDesign(view, poses), seed)
        calibration = calibrate(scene.problem)
        assert calibration.success, calibration.message
        found.append(errors(tuple(camera.model for camera in calibration.cameras), scene)[0])
        expected.append(calibration.expected.reprojection_rms_px)
        opencv.append(errors(opencv_cameras(scene.problem, scene.cameras[0], trim=False), scene)[0])
    assert rms(np.array(found)) < 1.4 * rms(np.array(expected))
    assert rms(np.array(found)) < 1.03 * rms(np.array(opencv))


@pytest.mark.parametrize("view", [10.0, 60.0])
def test_the_unit_of_length_does_not_matter(view):
    metres = make_lens_scene(LensDesign(view, 30), 5)
    spots = metres.problem.spots.copy()
    spots[0, 3] += 25.0
    reference = calibrate(replace(metres.problem, spots=spots))
    for unit in (1e-3, 39.37):
        problem = replace(make_lens_scene(LensDesign(view, 30, metre=unit), 5).problem, spots=spots)
        calibration = calibrate(problem)
        assert calibration.success, calibration.message
        np.testing.assert_array_equal(calibration.used, reference.used)
        for camera, other in zip(calibration.cameras, reference.cameras, strict=True):
            np.testing.assert_allclose(camera.model.K, other.model.K, rtol=1e-4, atol=0.01)
            np.testing.assert_allclose(camera.model.t_cam_base, unit * other.model.t_cam_base, rtol=1e-4)


def test_derivatives_of_the_prior_by_finite_differences():
    calibration = calibrate(make_lens_scene(LensDesign(10.0), 1).problem)
    layout, unknowns = ParameterLayout.of(make_lens_scene(LensDesign(10.0), 1).problem), unknowns_of(calibration, 40)
    prior = layout.prior(unknowns)
    for i, scale in ((0, 1.0), (2, 1.0), (4, 1e-2), (5, 1.0), (6, 1e-3), (14, 1.0)):
        step = np.zeros(layout.size)
        step[i] = 1e-3 * scale
        ahead = layout.prior(unknowns.moved(step, layout, unknowns.displacements)).chi2
        back = layout.prior(unknowns.moved(-step, layout, unknowns.displacements)).chi2
        assert (back - ahead) / (4.0 * step[i]) == pytest.approx(prior.gradient[i], rel=1e-4, abs=1e-9)


def test_rejected_poses_are_not_taken_for_a_camera_that_moved():
    problem = make_scene(Design(poses=60), 21).problem
    positions, rng = problem.positions.copy(), np.random.default_rng(3)
    positions[:26] += rng.normal(0.0, 0.05, (26, 3))
    calibration = calibrate(replace(problem, positions=positions))
    assert not calibration.success
    assert "as if it had moved" not in calibration.message


def test_the_worst_camera_is_the_one_that_the_others_contradict():
    problem = make_scene(Design(sigma_m=2e-3, sigma_px=0.05, led_offset_prior_sd=0.0), 4).problem
    rng = np.random.default_rng(5)
    spots = problem.spots.copy()
    spots[1] += rng.normal(0.0, 0.15, spots[1].shape)
    told = calibrate(replace(problem, spots=spots)).message
    assert "camera_1 is worst with chi2/dof" in told
    assert float(told.split("camera_1 is worst with chi2/dof ")[1].split()[0]) > 1.5
