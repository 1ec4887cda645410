"""Data sets in files: read without the truth, answered trial by trial, refused with a reason."""

import json

import numpy as np
import pytest

from im_core.errors import DataError
from im_vss.calibration.dataset import answer, main
from im_vss.calibration.synthetic import Design, make_scene


def dataset(design, seeds, **changes):
    """A file of this format from synthetic scenes; they share noise and wrists only if there is one seed."""
    scenes = [make_scene(design, seed) for seed in seeds]
    problem = scenes[0].problem
    content = {
        "schema": "vislab-calib-1",
        "image_size": [640, 480],
        "sigma_u_px": np.sqrt(problem.spot_covariances[..., 0, 0]).tolist(),
        "cov_x_m2": problem.position_covariances.tolist(),
        "wrist_R_base": problem.wrist_rotations.tolist(),
        "led_offset_nominal_known": design.led_offset_prior_sd == 0.0,
        "led_offset_prior_sd_m": design.led_offset_prior_sd,
        "joint_offset_prior_sd_rad": design.joint_offset_prior_sd,
        "J_joint": None if problem.joint_jacobians is None else problem.joint_jacobians.tolist(),
        "trials": [
            {
                "x_base_m": scene.problem.positions.tolist(),
                "u_px": [[None if np.isnan(uv[0]) else list(uv) for uv in camera] for camera in scene.problem.spots],
            }
            for scene in scenes
        ],
    }
    return scenes, {**content, **changes}


def test_a_trial_is_answered_with_cameras_and_flags():
    scenes, content = dataset(Design(missing_share=0.1, joint_offset_prior_sd=0.003), [1])
    trial = answer(content)["trials"][0]
    assert trial["flags"] == []
    assert len(trial["cameras"]) == 2
    np.testing.assert_allclose(trial["cameras"][0]["K"], scenes[0].cameras[0].K, atol=25.0)
    np.testing.assert_allclose(trial["led_offset_error_m"], scenes[0].led_offset_error, atol=2e-3)
    assert 0.5 < trial["chi2_per_dof"] < 1.5
    assert len(trial["joint_offsets_rad"]) == 6


def test_a_known_led_offset_needs_no_wrist_rotations():
    _, content = dataset(Design(led_offset_prior_sd=0.0), [2])
    del content["wrist_R_base"]
    trial = answer(content)["trials"][0]
    assert trial["flags"] == []
    assert "led_offset_error_m" not in trial


def test_where_there_is_no_estimate_the_flag_says_why():
    _, content = dataset(Design(poses=5), [3])
    trial = answer(content)["trials"][0]
    assert trial["cameras"] == []
    assert trial["flags"] == ["UNOBSERVABLE"]
    assert "at least 7" in trial["message"]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"schema": "other"}, "has the schema 'other', 'vislab-calib-1' is needed"),
        ({"trials": []}, "has no trials"),
        ({"image_size": "big"}, "wrong kind"),
        ({"sigma_u_px": [[0.1]]}, r"sigma_u_px has shape \(1, 1\)"),
        ({"trials": [{"u_px": []}]}, "no field 'x_base_m'"),
    ],
)
def test_malformed_files_are_refused(change, sentence):
    _, content = dataset(Design(poses=10), [4], **change)
    with pytest.raises(DataError, match=sentence):
        answer(content)


def test_the_script_writes_the_answers(tmp_path, capsys):
    _, content = dataset(Design(), [5])
    source, target = tmp_path / "in.json", tmp_path / "out.json"
    source.write_text(json.dumps(content))
    assert main([str(source), str(target)]) == 0
    assert len(json.loads(target.read_text())["trials"]) == 1
    assert "trial 0: Calibrated camera_0, camera_1" in capsys.readouterr().out


@pytest.mark.parametrize(("text", "sentence"), [("{", "in.json:1: not JSON"), ("[]", "schema 'list'")])
def test_the_script_says_what_is_wrong_with_a_file(tmp_path, capsys, text, sentence):
    source = tmp_path / "in.json"
    source.write_text(text)
    assert main([str(source), str(tmp_path / "out.json")]) == 1
    assert sentence in capsys.readouterr().err


def test_the_script_names_a_missing_file(tmp_path, capsys):
    assert main([str(tmp_path / "none.json"), str(tmp_path / "out.json")]) == 1
    assert "none.json: No such file" in capsys.readouterr().err
