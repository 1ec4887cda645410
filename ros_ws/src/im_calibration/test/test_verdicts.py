"""Verdicts: what cannot be known is said, what does not fit is said, what is good passes."""

from dataclasses import replace

import numpy as np
import pytest

from bench.calibration.synthetic import Design, make_scene, random_rotations
from bench.calibration.verdicts import BAD
from im_calibration import DegenerateDataError, InconsistentDataError, calibrate
from im_calibration.estimation.unknowns import rotation_exp
from im_calibration.judgement.verdicts import UNOBSERVABLE
from im_calibration.reporting.report import answer

MISFITS = ("camera moved by 1 px", "LED offset not as stated", "robot 1 % too small, known lengths")


def kinds(calibration):
    return {verdict.kind for verdict in calibration.verdicts}


def parameters(calibration):
    return {name for verdict in calibration.verdicts for name in verdict.parameters}


def flat_positions(seed, tilt=0.0, thickness=0.0):
    points = np.random.default_rng(seed).uniform((-1.0, -0.5, -0.5), (1.0, 0.5, 0.5), (40, 3))
    points[:, 2] = 1.1 + tilt * points[:, 0] + thickness * points[:, 2]
    return points


@pytest.mark.parametrize(
    ("design", "tilt"), [(Design(sigma_px=0.02, sigma_m=5e-5), 0.0), (Design(sigma_px=0.4, sigma_m=2e-3), 0.4)]
)
def test_coplanar_positions_are_unobservable(design, tilt):
    calibration = calibrate(make_scene(design, 1, positions=flat_positions(1, tilt)).problem)
    assert kinds(calibration) == {"UNOBSERVABLE"}
    assert {"camera_0.fx", "camera_1.fx"} <= parameters(calibration)
    assert "plane" in calibration.message
    assert "height" in calibration.verdicts[0].advice
    assert str(calibration.verdicts[0]).startswith("UNOBSERVABLE: The LED positions")
    assert calibration.message.count("Vary the height") == 1


def test_poses_in_a_flat_but_thick_slab_are_not_called_coplanar():
    calibration = calibrate(make_scene(Design(), 2, positions=flat_positions(2, thickness=0.4)).problem)
    assert calibration.success, calibration.message


@pytest.mark.parametrize("prior", [0.005, 0.05])
def test_a_wrist_that_does_not_turn_hides_the_led_offset(prior):
    wrists = np.tile(random_rotations(np.random.default_rng(3), 1), (40, 1, 1))
    calibration = calibrate(make_scene(Design(led_offset_prior_sd=prior), 3, wrists=wrists).problem)
    assert kinds(calibration) == {"UNOBSERVABLE"}
    assert {"led_offset.x", "led_offset.y", "led_offset.z", "camera_0.tx"} <= parameters(calibration)
    assert "wrist" in calibration.message


def test_a_wrist_that_turns_about_one_axis_hides_the_offset_along_it():
    angles = np.random.default_rng(4).uniform(-2.0, 2.0, 40)
    wrists = rotation_exp(np.column_stack((0.0 * angles, 0.0 * angles, angles)))
    calibration = calibrate(make_scene(Design(), 4, wrists=wrists).problem)
    assert kinds(calibration) == {"UNOBSERVABLE"}
    assert {name for name in parameters(calibration) if name.startswith("led")} == {"led_offset.z"}


def test_a_wrist_that_does_not_turn_is_fine_with_a_known_offset():
    wrists = np.tile(np.eye(3), (40, 1, 1))
    calibration = calibrate(make_scene(Design(led_offset_prior_sd=0.0), 5, wrists=wrists).problem)
    assert calibration.success, calibration.message


def test_eight_poses_are_too_few_to_trust():
    calibration = calibrate(make_scene(Design(poses=8), 6).problem)
    assert kinds(calibration) == {"UNOBSERVABLE"}
    assert "too few" in calibration.message


def test_a_handful_of_poses_is_refused():
    with pytest.raises(DegenerateDataError, match="at least 7 are needed"):
        calibrate(make_scene(Design(poses=5), 7).problem)


def test_poses_in_a_corner_do_not_determine_the_lens():
    near = np.random.default_rng(8).uniform((-0.1, -0.1, 1.0), (0.1, 0.1, 1.2), (40, 3))
    calibration = calibrate(make_scene(Design(), 8, positions=near).problem)
    assert kinds(calibration) == {"UNOBSERVABLE"}
    assert "camera_0.k2" in parameters(calibration)


def test_a_camera_that_moved_is_a_misfit():
    problem = make_scene(Design(), 10).problem
    spots = problem.spots.copy()
    spots[1, 20:] += [40.0, 13.0]
    calibration = calibrate(replace(problem, spots=spots))
    assert kinds(calibration) == {"MISFIT"}
    assert "camera_1" in calibration.message
    assert "did not move" in calibration.verdicts[0].advice


def test_spots_of_other_poses_are_a_misfit_or_refused():
    try:
        found = kinds(calibrate(BAD["spots of other poses"].make(0)))
    except InconsistentDataError as error:
        found = {error.code.upper()}
    assert "MISFIT" in found


@pytest.mark.parametrize("seed", [301, 302, 305])
def test_good_data_get_no_verdict(seed):
    rng = np.random.default_rng(seed)
    design = Design(
        poses=int(rng.integers(25, 50)),
        sigma_px=10.0 ** rng.uniform(-1.5, -0.3),
        sigma_m=10.0 ** rng.uniform(-4.0, -2.8),
        outlier_share=rng.choice([0.0, 0.2]),
        led_offset_prior_sd=rng.choice([0.0, 0.005, 0.05]),
    )
    calibration = calibrate(make_scene(design, seed).problem)
    assert calibration.success, calibration.message


@pytest.mark.parametrize("seed", range(3))
def test_positions_on_a_line_are_unobservable_even_with_stale_readings(seed):
    along = np.random.default_rng(seed).uniform(-1.0, 1.0, (40, 1))
    points = np.array([0.0, 0.0, 1.1]) + along * np.array([0.9, 0.3, 0.3])
    with pytest.raises(DegenerateDataError, match="on a line"):
        calibrate(make_scene(Design(outlier_share=0.1), seed, positions=points).problem)


def test_poses_on_two_floors_with_few_on_the_upper_are_not_on_a_plane():
    points = np.random.default_rng(12).uniform((-1.0, -0.5, 0.7), (1.0, 0.5, 0.7), (40, 3))
    points[::6, 2] = 1.5
    calibration = calibrate(make_scene(Design(), 12, positions=points).problem)
    assert calibration.success, calibration.message


def test_noise_below_the_arithmetic_is_refused():
    problem = make_scene(Design(poses=20), 13).problem
    tiny = np.tile(1e-18 * np.eye(2), (2, 20, 1, 1))
    with pytest.raises(InconsistentDataError):
        calibrate(replace(problem, spot_covariances=tiny))


@pytest.mark.parametrize("kind", [*(kind for kind, bad in BAD.items() if bad.verdict == UNOBSERVABLE), *MISFITS])
def test_each_kind_of_bad_data_gets_its_verdict(kind):
    """Three sets of every kind are a part of ``bench.calibration``."""
    bad = BAD[kind]
    assert answer(bad.make(3))["flags"] == [bad.verdict]


def test_a_camera_that_moved_a_little_is_told_from_outliers():
    calibration = calibrate(BAD["camera moved by 1 px"].make(909))
    assert kinds(calibration) == {"MISFIT"}
    assert "as if it had moved" in calibration.message


@pytest.mark.parametrize("cameras", [1, 2])
def test_spots_that_agree_outside_of_the_image_are_a_misfit(cameras):
    """Some of the spots of 640 x 480 px are below or beside 480 x 640 px, and all fit a camera."""
    problem = make_scene(Design(cameras=cameras), 14).problem
    calibration = calibrate(replace(problem, image_sizes=((480, 640),) * cameras))
    assert kinds(calibration) == {"MISFIT"}
    assert "are not in its image of 480 x 640 px: with width and height exchanged they are." in calibration.message


def test_an_outlier_outside_of_the_image_is_no_misfit():
    problem = make_scene(Design(), 15).problem
    spots = problem.spots.copy()
    spots[0, 3] = [-200.0, 900.0]
    assert calibrate(replace(problem, spots=spots)).success


def test_a_misfit_of_wrong_units_says_so():
    """Positions in millimetres with covariances in metres; an image size that is not the camera's."""
    problem = make_scene(Design(led_offset_prior_sd=0.0), 5).problem
    reason = calibrate(replace(problem, positions=1e3 * problem.positions)).message
    assert "MISFIT" in reason
    assert "m and more from their median: are they metres?" in reason
    reason = calibrate(replace(problem, image_sizes=((64, 48),) * 2)).message
    assert "MISFIT" in reason
    assert "spots of camera_1 are not in its image of 64 x 48 px." in reason
    assert "units and axes of the data [m, px]" in reason
