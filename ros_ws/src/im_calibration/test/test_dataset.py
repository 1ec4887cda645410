"""Data sets in files: read without the truth, answered trial by trial, refused with a reason that names the place."""

import copy
import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bench.calibration.synthetic import Design, make_scene
from im_calibration.commands import calibrate_dataset, command, next_best_pose
from im_calibration.problem.dataset import problems
from im_calibration.reporting.report import answer
from im_core.errors import DataError


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


SMALL = dataset(Design(poses=10, joint_offset_prior_sd=0.003), [4])[1]


def first_answer(content):
    return answer(problems(content)[0])


def test_a_trial_is_answered_with_cameras_and_flags():
    scenes, content = dataset(Design(missing_share=0.1, joint_offset_prior_sd=0.003), [1])
    trial = first_answer(content)
    assert trial["flags"] == []
    assert len(trial["cameras"]) == 2
    np.testing.assert_allclose(trial["cameras"][0]["K"], scenes[0].cameras[0].K, atol=25.0)
    np.testing.assert_allclose(trial["led_offset_error_m"], scenes[0].led_offset_error, atol=2e-3)
    assert 0.5 < trial["chi2_per_dof"] < 1.5
    assert len(trial["joint_offsets_rad"]) == 6
    covariance = np.array(trial["covariance"])
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), trial["standard_deviations"])
    assert len(trial["parameters"]) == len(covariance) == 2 * 14 + 3 + 6
    assert all(value > 0.0 for value in trial["checks"].values())


def test_the_truth_in_a_file_changes_nothing():
    _, content = dataset(Design(poses=20), [6])
    told = {"truth": "nonsense", "heldout_points_base_m": [1], "bounds_crlb_rms": None, "reference_rms": {}}
    trials = [{**trial, "truth": 3} for trial in content["trials"]]
    assert first_answer({**content, **told, "trials": trials}) == first_answer(content)


def test_a_known_led_offset_needs_no_wrist_rotations():
    _, content = dataset(Design(led_offset_prior_sd=0.0), [2])
    del content["wrist_R_base"]
    trial = first_answer(content)
    assert trial["flags"] == []
    assert "led_offset_error_m" not in trial


def test_where_there_is_no_estimate_the_flag_says_why():
    _, content = dataset(Design(poses=5), [3])
    trial = first_answer(content)
    assert trial["cameras"] == []
    assert trial["flags"] == ["UNOBSERVABLE"]
    assert "at least 7" in trial["message"]
    (verdict,) = trial["verdicts"]
    assert verdict["parameters"]
    assert verdict["advice"] == "Add poses in its view, or leave the camera out."
    assert trial["message"] == f"UNOBSERVABLE: {verdict['reason']} {verdict['advice']}"


def without(content, key):
    del content[key]


def without_poses(content):
    for key in ("cov_x_m2", "wrist_R_base", "J_joint"):
        content[key] = []
    content["sigma_u_px"] = [[] for _ in content["sigma_u_px"]]
    for trial in content["trials"]:
        trial |= {"x_base_m": [], "u_px": [[] for _ in trial["u_px"]]}


def put(value, *path):
    def change(content):
        for step in path[:-1]:
            content = content[step]
        content[path[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (put("other", "schema"), "schema is 'other', 'vislab-calib-1' is needed"),
        (lambda content: without(content, "cov_x_m2"), "the data set has no field 'cov_x_m2'"),
        (put([], "trials"), "at least one trial"),
        (put("big", "image_size"), "image_size is a text, a list of 2 is needed"),
        (put([640, -1], "image_size"), "image_size is 640 x -1"),
        (without_poses, "needs poses, none is given"),
        (put([[0.1]], "sigma_u_px"), r"sigma_u_px\[0\] has 1 elements, 10 are needed"),
        (put(0, "sigma_u_px", 1, 3), r"sigma_u_px\[1\]\[3\] is 0, it must be > 0"),
        (put(None, "wrist_R_base"), "wrist_R_base is null"),
        (put("yes", "led_offset_nominal_known"), "true or false is needed"),
        (put(-1.0, "led_offset_prior_sd_m"), "led_offset_prior_sd_m is -1"),
        (put(None, "J_joint"), "J_joint is null"),
        (put([1, 2], "trials", 0), r"trials\[0\] is a list, an object with the field 'x_base_m' is needed"),
        (lambda content: without(content["trials"][0], "u_px"), r"trials\[0\] has no field 'u_px'"),
        (put([1.0], "trials", 0, "u_px", 1, 7), r"trials\[0\]\.u_px\[1\]\[7\] has 1 elements, 2 are needed"),
        (put(True, "trials", 0, "u_px", 0, 7, 1), r"trials\[0\]\.u_px\[0\]\[7\]\[1\] is a truth value"),
        (put(10**400, "trials", 0, "x_base_m", 2, 1), r"trials\[0\]\.x_base_m\[2\]\[1\] is inf"),
        (put([[1, 0, 0], [0, 1, 0], [0, 0, -1]], "cov_x_m2", 5), "covariance of pose 5 is not a covariance"),
        (put([[2, 0, 0], [0, 1, 0], [0, 0, 1]], "wrist_R_base", 5), "wrist rotation of pose 5 is not a rotation"),
    ],
)
def test_malformed_data_sets_are_refused(change, sentence):
    content = copy.deepcopy(SMALL)
    change(content)
    with pytest.raises(DataError, match=sentence):
        problems(content)


SCALARS = st.none() | st.booleans() | st.integers(-3, 3) | st.floats() | st.text(max_size=3)
ANYTHING = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=2)
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(sorted(SMALL)), st.lists(st.integers(0, 9), max_size=4), ANYTHING)
def test_whatever_stands_in_a_field_there_is_a_problem_or_a_sentence(key, path, value):
    content = copy.deepcopy(SMALL)
    inner, last = content, key
    for step in path:
        if not isinstance(inner[last], list) or step >= len(inner[last]):
            break
        inner, last = inner[last], step
    inner[last] = value
    try:
        found = problems(content)
    except DataError as error:
        refusal = error.message
    else:
        refusal = ""
        assert len(found) == len(content["trials"])
    assert not refusal or len(refusal) > 10


def test_the_command_writes_the_answers(tmp_path, capsys):
    _, content = dataset(Design(), [5])
    source, target = tmp_path / "in.json", tmp_path / "out.json"
    source.write_text(json.dumps(content))
    assert calibrate_dataset.main([str(source), str(target)]) == command.OK
    assert len(json.loads(target.read_text())["trials"]) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.json", "out.json"]
    assert "trial 0: Calibrated camera_0, camera_1" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (b"{\n", "in.json:2:1: not JSON"),
        (b"[]", "in.json: the data set is a list"),
        (b"[NaN]", "in.json: NaN is not a number of JSON"),
        (b"[" * 100_000, "in.json: values nest deeper than 40"),
        (b"\xff\xfe", "in.json:1:1: is not UTF-8 text"),
    ],
)
def test_the_command_says_what_is_wrong_with_a_file(tmp_path, capsys, text, sentence):
    source, target = tmp_path / "in.json", tmp_path / "out.json"
    source.write_bytes(text)
    target.write_text("before")
    assert calibrate_dataset.main([str(source), str(target)]) == command.BAD_INPUT
    assert sentence in capsys.readouterr().err
    assert target.read_text() == "before"


def test_the_command_names_a_file_it_cannot_use(tmp_path, capsys):
    assert calibrate_dataset.main([str(tmp_path / "none.json"), str(tmp_path / "out.json")]) == 1
    assert "none.json: cannot be read: No such file" in capsys.readouterr().err
    source = tmp_path / "in.json"
    source.write_text(json.dumps(SMALL))
    for target in (tmp_path, tmp_path / "no" / "out.json", source):
        assert calibrate_dataset.main([str(source), str(target)]) == 1
        assert str(target) in capsys.readouterr().err
    assert json.loads(source.read_text()) == SMALL


def test_a_data_set_may_hold_known_lengths():
    scenes, content = dataset(Design(lengths=3), [11])
    content["known_lengths"] = {"length_m": [0.5] * 3, "sd_m": [1e-4] * 3, "sigma_u_px": [[0.1] * 3] * 2}
    spots = scenes[0].problem.lengths.spots.tolist()
    spots[1][2][0] = None
    content["trials"][0]["length_u_px"] = spots
    lengths = problems(content)[0].lengths
    assert lengths.detected.sum() == 11
    np.testing.assert_allclose(lengths.spot_covariances[0, 1, 1], 0.01 * np.eye(2))
    assert first_answer(content)["scale"]["lengths_used"] == 2
    content["known_lengths"]["length_m"][1] = -0.5
    with pytest.raises(DataError, match="known length must be > 0 and at most 1000 m"):
        problems(content)
    del content["trials"][0]["length_u_px"]
    with pytest.raises(DataError, match=r"trials\[0\] has no field 'length_u_px'"):
        problems(content)


def test_the_command_names_the_next_best_poses(tmp_path, capsys):
    _, content = dataset(Design(poses=20), [7])
    data, poses = tmp_path / "data.json", tmp_path / "poses.yaml"
    data.write_text(json.dumps(content))
    pose = {"orientation_xyzw": [0.0, 0.0, 0.0, 1.0]}
    places = np.random.default_rng(1).uniform((-1.0, -0.5, 0.6), (1.0, 0.5, 1.6), (8, 3)).tolist()
    listed = [{"name": f"p{i}", "position_m": place, **pose} for i, place in enumerate(places)]
    poses.write_text(json.dumps({"frame": "world", "poses": listed}))
    assert next_best_pose.main([str(data), str(poses), "--count", "3"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert lines[1].split()[0] in {f"p{i}" for i in range(8)}
    assert next_best_pose.main([str(data), str(poses), "--trial", "1"]) == 1
    assert "there is no trial 1" in capsys.readouterr().err
