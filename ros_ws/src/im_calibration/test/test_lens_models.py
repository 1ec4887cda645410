"""Lens models: those that are chosen are estimated, those that are too small are told, with the one to take."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bench.calibration.kinds import HARD
from bench.calibration.lenses import LensDesign, make_lens_scene
from bench.calibration.score import errors
from bench.calibration.synthetic import Design, bent, make_scene
from im_calibration import calibrate, dataset_of
from im_calibration.commands.calibrate_dataset import main
from im_calibration.estimation.covariance import Covariance
from im_calibration.estimation.unknowns import ParameterLayout
from im_calibration.judgement.lenses import LensFault
from im_calibration.judgement.neighbours import Neighbours
from im_calibration.judgement.verdicts import judge
from im_calibration.problem.dataset import problems
from im_cell.calibration_error import rms
from im_core.errors import DataError


@pytest.mark.parametrize(
    ("lens", "view", "model"),
    [
        ("k3", 60.0, "rational_polynomial"),
        ("rational", 70.0, "rational_polynomial"),
        ("fisheye", 80.0, "equidistant"),
        ("fisheye", 120.0, "equidistant"),
    ],
)
def test_a_lens_is_found_by_its_own_model_as_well_as_predicted(lens, view, model):
    found, expected = [], []
    for seed in range(50, 52):
        scene = make_lens_scene(LensDesign(view, 60, lens=lens, fitted=model, depth_m=1.0), seed)
        calibration = calibrate(scene.problem)
        assert calibration.success, calibration.message
        assert {camera.model.distortion_model for camera in calibration.cameras} == {model}
        found.append(errors(tuple(camera.model for camera in calibration.cameras), scene)[0])
        expected.append(calibration.expected.reprojection_rms_px)
    assert rms(np.array(found)) < 1.4 * rms(np.array(expected))


@pytest.mark.parametrize(
    ("lens", "view", "better"),
    [("k3", 60.0, "rational_polynomial"), ("fisheye", 80.0, "equidistant")],
)
def test_a_model_too_small_is_told_with_the_one_to_take(lens, view, better):
    scene = make_lens_scene(LensDesign(view, 60, lens=lens, depth_m=1.0), 2)
    calibration = calibrate(scene.problem)
    assert {verdict.kind for verdict in calibration.verdicts} == {"MISFIT"}
    assert "The lens model plumb_bob does not fit camera_" in calibration.message
    assert f"{better} predicts poses from the others to" in calibration.message
    assert f"as {better} (--lens-model" in calibration.message


@pytest.mark.parametrize(("lens", "view"), [("mild", 40.0), ("barrel", 60.0)])
def test_a_model_that_fits_is_not_doubted(lens, view):
    for seed in range(4):
        calibration = calibrate(make_lens_scene(LensDesign(view, lens=lens, depth_m=1.0), seed).problem)
        assert calibration.success, calibration.message


@pytest.mark.parametrize(
    ("kind", "size_m", "seed"), [("links", 3e-4, 0), ("quadratic", 1e-3, 1), ("links", 1e-3, 1), ("quadratic", 2e-3, 0)]
)
def test_the_error_of_an_arm_is_not_blamed_on_the_lens(kind, size_m, seed):
    design = LensDesign(60.0, 80, cameras=1, depth_m=0.6, sigma_m=5e-5, lens="barrel")
    problem = bent(make_lens_scene(design, seed), kind, size_m, seed).problem
    calibration = calibrate(replace(problem, noise_to_estimate=("image", "robot")))
    assert "lens model" not in calibration.message


@pytest.mark.parametrize(("lens", "view"), [("k3", 60.0), ("fisheye", 80.0)])
def test_a_wrong_lens_is_not_taken_for_the_error_of_an_arm(lens, view):
    problem = make_lens_scene(LensDesign(view, 80, cameras=1, lens=lens, depth_m=1.0), 1).problem
    calibration = calibrate(replace(problem, noise_to_estimate=("image", "robot")))
    assert "The lens model plumb_bob does not fit camera_0" in calibration.message


def test_a_model_that_predicts_hardly_better_is_not_proposed():
    """This set is suspicious by chance, and an equidistant lens predicts it a little better."""
    assert calibrate(make_scene(HARD["everything"], 30078).problem).success


def test_cameras_of_different_models_are_calibrated_together(tmp_path):
    """A usual camera and a fisheye, through files and the command."""
    scene = make_lens_scene(LensDesign(80.0, 60, lens="fisheye", depth_m=1.0), 7)
    content = dataset_of(scene.problem)
    content["distortion_model"] = ["rational_polynomial", "equidistant"]
    assert [lens.estimated for lens in problems(content)[0].lenses] == [8, 4]
    (tmp_path / "in.json").write_text(json.dumps(content))
    assert main([str(tmp_path / "in.json"), str(tmp_path / "out.json")]) == 0
    answer = json.loads((tmp_path / "out.json").read_text())["trials"][0]
    assert [len(camera["D"]) for camera in answer["cameras"]] == [8, 4]
    assert len(answer["parameters"]) == 18 + 14
    assert main(["--lens-model", "equidistant", str(tmp_path / "in.json"), str(tmp_path / "out.json")]) == 0
    answer = json.loads((tmp_path / "out.json").read_text())["trials"][0]
    assert {camera["distortion_model"] for camera in answer["cameras"]} == {"equidistant"}
    assert answer["flags"] == []


def test_unknown_models_are_refused_by_field():
    content = dataset_of(make_lens_scene(LensDesign(40.0, 10), 1).problem)
    for value, sentence in (
        ("omni", "distortion_model is 'omni': lens model 'omni' is unknown, it must be one of plumb_bob, ratio"),
        (3, "distortion_model must be the name of a lens model"),
        (["plumb_bob"] * 3, "There are 3 lens models for 2 cameras"),
    ):
        with pytest.raises(DataError, match=sentence):
            problems({**content, "distortion_model": value})


def test_a_pattern_is_told_once_with_the_lens_that_leaves_it():
    problem = make_scene(Design(), 1).problem
    good = replace(calibrate(problem), neighbours=Neighbours(0.62, 0.1))
    known = Covariance(good.covariance, np.zeros(len(good.covariance), dtype=bool))
    fault = LensFault(0, "plumb_bob", "the direction from the middle of the image", 1e-9)
    verdicts = judge(good, problem, ParameterLayout.of(problem), known, (), (fault,))
    why = "(p 1e-09), and neighbouring spots are off alike (correlation 0.62, of noise below 0.10)."
    assert [verdict.reason.endswith(why) for verdict in verdicts] == [True]
    assert replace(good, verdicts=verdicts).message.count("neighbouring spots") == 1
    assert "no noise" not in replace(good, verdicts=verdicts).message
