"""Known lengths through ``/vss/calibrate``: the only judge of the robot's own scale (docs/calibration.md)."""

import json

import numpy as np
import pytest

from bench.calibration.synthetic import Design, make_scene
from im_msgs.srv import Calibrate


@pytest.fixture(scope="module")
def ask(machine, calibration_request):
    """``ask(design, spoil)``: the answer of ``/vss/calibrate`` for a synthetic scene, after `spoil(fields)`."""

    def call(design, spoil=lambda fields: None):
        fields = calibration_request(make_scene(design, 5).problem)
        spoil(fields)
        return machine.call(Calibrate, "/vss/calibrate", **fields)

    return call


def test_a_robot_one_percent_too_long_is_revealed_by_lengths_alone(ask):
    without = ask(Design(scale_error=0.01))
    assert without.success, without.status.message
    report = without.report
    assert report.success
    assert (report.verdicts, report.lengths_used) == ([], 0)
    assert np.isnan([report.scale_error, report.scale_sd]).all()
    found = ask(Design(scale_error=0.01, lengths=8))
    assert found.success, found.status.message
    report = found.report
    assert not report.success
    (verdict,) = report.verdicts
    assert "MISFIT: Known lengths are 1.0" in verdict
    assert [v["parameters"] for v in json.loads(report.json)["verdicts"]] == [["robot.scale"]]
    assert report.lengths_used == 8
    assert 0.0 < report.scale_sd < 0.002
    assert abs(report.scale_error - 0.01) < 4.0 * report.scale_sd


def test_a_right_robot_is_confirmed(ask):
    report = ask(Design(lengths=8)).report
    assert report.success, report.message
    assert abs(report.scale_error) < 4.0 * report.scale_sd


def test_a_light_that_one_camera_saw_gives_no_length(ask):
    def blind(fields):
        for length in fields["known_lengths"]:
            length.second = [spot for spot in length.second if spot.camera == "ceiling_left"]

    report = ask(Design(lengths=3), blind).report
    assert report.success, report.message
    assert report.lengths_used == 0


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda known: setattr(known, "length", 0.0), "known length 1 is 0 m, it must be finite and > 0"),
        (lambda known: setattr(known, "length", float("nan")), "known length 1 is nan m, it must be finite and > 0"),
        (
            lambda known: setattr(known, "sd", -1e-4),
            "the sd of known length 1 is -0.0001 m, it must be finite and >= 0",
        ),
        (lambda known: known.first.append(known.first[0]), "known length 1, first has two spots of ceiling_left"),
        (
            lambda known: setattr(known.second[0], "u", float("inf")),
            "known length 1, second: the spot of ceiling_left at [inf,",
        ),
        (
            lambda known: setattr(known.second[0], "covariance", np.zeros(4)),
            "is no covariance of a spot of ceiling_left [px^2]",
        ),
        (lambda known: setattr(known.first[0], "camera", "sealing"), "there is no camera 'sealing'"),
    ],
)
def test_wrong_lengths_are_one_sentence(ask, spoil, sentence):
    answer = ask(Design(poses=12, lengths=3), lambda fields: spoil(fields["known_lengths"][1]))
    assert not answer.success
    assert sentence in answer.status.message
