"""One camera that saw too little does not cost the others their calibration."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bench.calibration.synthetic import Design, make_scene
from im_calibration import (
    DegenerateDataError,
    calibrate,
    calibrate_possible,
    dataset_of,
    load_problems,
    report_of,
    write_observations,
    write_results,
)
from im_calibration.commands import calibrate_dataset, command
from im_cell.calibration_summary import summary


def blinded(problem, camera, spots):
    """The problem in which a camera saw only the first few of its spots."""
    seen = problem.spots.copy()
    seen[camera, np.flatnonzero(problem.detected[camera])[spots:]] = np.nan
    return replace(problem, spots=seen)


@pytest.fixture(scope="module")
def scene():
    return make_scene(Design(cameras=3, missing_share=0.1), 5).problem


def matrices(calibration):
    return [camera.model.K for camera in calibration.cameras]


@pytest.fixture(scope="module")
def others(scene):
    return calibrate(scene.of_cameras(["camera_0", "camera_2"]))


@pytest.mark.parametrize(("spots", "said"), [(0, "saw the LED in 0 poses"), (8, "has 8 spots")])
def test_a_camera_with_too_few_spots_is_named_and_the_others_are_calibrated(scene, others, spots, said):
    problem = blinded(scene, 1, spots)
    told = calibrate_possible(problem)
    assert [camera.name for camera in told.cameras] == ["camera_0", "camera_2"]
    np.testing.assert_array_equal(matrices(told), matrices(others))
    assert (told.usable, told.success) == (True, False)
    assert told.message.startswith("Calibrated camera_0, camera_2 from ")
    assert "Left out: " in told.message
    assert said in told.left_out[0].reason
    report = json.loads(json.dumps(report_of(told, problem), allow_nan=False))
    assert report["success"] is False
    assert [verdict["kind"] for verdict in report["verdicts"]] == ["UNOBSERVABLE"]
    assert said in summary(report)


def test_several_cameras_may_be_left_out(scene):
    told = calibrate_possible(blinded(blinded(scene, 0, 2), 2, 8))
    assert [camera.name for camera in told.cameras] == ["camera_1"]
    assert {verdict.reason.split()[0] for verdict in told.left_out} == {"Camera", "camera_2"}


def test_a_camera_whose_spots_are_anywhere_is_left_out_or_spoils_no_word(scene):
    pair = scene.of_cameras(["camera_0", "camera_1"])
    spots = pair.spots.copy()
    spots[0] = np.random.default_rng(1).uniform((0.0, 0.0), pair.image_sizes[0], spots[0].shape)
    told = calibrate_possible(replace(pair, spots=spots))
    assert not told.success


def test_where_no_camera_can_be_calibrated_the_reason_is_an_error(scene):
    none = replace(scene, spots=np.full_like(scene.spots, np.nan))
    with pytest.raises(DegenerateDataError, match="saw the LED in 0 poses"):
        calibrate_possible(none)


def test_a_fault_of_all_cameras_leaves_none_out():
    flat = np.random.default_rng(0).uniform((-1.0, -0.5, 1.0), (1.0, 0.5, 1.0), (40, 3))
    problem = make_scene(Design(cameras=2), 2, positions=flat).problem
    told = calibrate_possible(problem)
    assert told.left_out == ()
    assert len(told.cameras) == 2
    assert not told.usable


def test_files_are_written_for_the_cameras_that_can_be_used_and_all_observations_are_kept(scene, tmp_path):
    problem = blinded(scene, 1, 3)
    write_observations(tmp_path, dataset_of(problem))
    write_results(tmp_path, calibrate_possible(problem), problem)
    written = {path.name for path in tmp_path.iterdir()}
    assert {"camera_0.yaml", "camera_2.yaml", "report.json", "residuals.png"} <= written
    assert "camera_1.yaml" not in written
    (kept,) = load_problems(tmp_path / "observations.json")
    np.testing.assert_array_equal(kept.detected, problem.detected)
    assert calibrate_dataset.main(["--again", str(tmp_path)]) == command.OK
    first, again = (json.loads((folder / "report.json").read_text()) for folder in (tmp_path, tmp_path / "again"))
    assert (again["message"], again["points_rejected"]) == (first["message"], first["points_rejected"])
    for one, other in zip(again["cameras"], first["cameras"], strict=True):
        np.testing.assert_allclose(one["K"], other["K"], rtol=1e-9)
    assert {path.name for path in (tmp_path / "again").iterdir()} == written - {"observations.json"}


def test_only_names_of_files_are_written_again(scene, tmp_path, capsys):
    named = replace(scene, camera_names=("a", "b", "../c"))
    write_observations(tmp_path / "folder", dataset_of(named))
    assert calibrate_dataset.main(["--again", str(tmp_path / "folder")]) == command.BAD_INPUT
    assert "camera_names has '../c', which is no name of a file" in capsys.readouterr().err
    assert not (tmp_path / "c.yaml").exists()


@pytest.mark.parametrize("words", [[], ["a.json"], ["a.json", "b.json", "--again", "c"], ["a.json", "--again", "c"]])
def test_a_data_set_or_a_folder_is_calibrated(words):
    with pytest.raises(SystemExit, match="2"):
        calibrate_dataset.main(words)
