"""Data that fit no camera: what they are instead is named."""

from dataclasses import replace

import numpy as np
import pytest

from bench.calibration.synthetic import Design, make_scene
from im_calibration import calibrate

SCENE = make_scene(Design(led_offset_prior_sd=0.02), 31)
EXACT = make_scene(Design(led_offset_prior_sd=0.0), 31)


def with_positions(problem, positions):
    return replace(problem, positions=positions)


def moved_from_20_on(problem):
    return with_positions(problem, problem.positions + np.where(np.arange(40) >= 20, 0.1, 0.0)[:, None] * [1.0, 0, 0])


def mirrored_camera(problem):
    spots = problem.spots.copy()
    spots[1, :, 0] = 639.0 - spots[1, :, 0]
    return replace(problem, spots=spots)


CAUSES = {
    "x, y, z taken from z, x, y": lambda p: with_positions(p, p.positions[:, [1, 2, 0]]),
    "the images of camera_1 are mirrored": mirrored_camera,
    "from pose 20 on the LED positions are off by (100, 0, 0) mm": moved_from_20_on,
}


@pytest.mark.parametrize("words", CAUSES)
def test_the_cause_is_named(words):
    calibration = calibrate(CAUSES[words](SCENE.problem))
    assert [verdict.kind for verdict in calibration.verdicts] == ["MISFIT"]
    assert words.lower() in calibration.cause.lower()
    assert calibration.message.startswith(f"MISFIT: {calibration.cause}")


def test_without_wrists_only_the_handedness_can_be_named():
    calibration = calibrate(with_positions(EXACT.problem, EXACT.problem.positions * [1.0, 1.0, -1.0]))
    assert "mirrored, or all images are: with one axis reversed, or two exchanged" in calibration.cause


def test_an_led_that_is_not_where_it_is_said_to_be_is_found():
    problem = EXACT.problem
    calibration = calibrate(with_positions(problem, problem.positions + problem.wrist_rotations @ [0.1, 0.05, 0.0]))
    assert "The LED is about (-100, -50, 0) mm" in calibration.cause


def test_outliers_have_no_cause():
    assert calibrate(make_scene(Design(outlier_share=0.2), 32).problem).cause == ""
