"""Further poses: what they will bring is what they bring, and the chosen ones beat those by chance."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import yaml

from bench.calibration.further_poses import further_poses
from bench.calibration.synthetic import Design, make_scene
from im_calibration import calibrate
from im_calibration.commands import next_best_pose
from im_calibration.design import Candidates, load_candidates, next_best_poses, unknowns_of
from im_calibration.estimation.residuals import linearise
from im_calibration.estimation.unknowns import ParameterLayout
from im_calibration.judgement.expected import expected_error
from im_calibration.problem.dataset import dataset_of
from im_core.errors import ConfigError, DataError

FIRST, POOL = np.arange(14), np.arange(14, 34)


def candidates_of(problem):
    return Candidates(
        problem.pose_names, problem.positions, problem.position_covariances, problem.wrist_rotations,
        problem.spot_covariances, problem.joint_jacobians,
    )  # fmt: skip


@pytest.fixture(scope="module")
def known():
    whole = make_scene(Design(poses=34, joint_offset_prior_sd=0.003), 2).problem
    first = whole.taking(FIRST)
    return calibrate(first), first, whole.taking(POOL)


def test_the_gain_is_that_of_the_whole_information_matrix(known):
    calibration, problem, pool = known
    best = next_best_poses(calibration, problem, candidates_of(pool))[0]
    layout, unknowns = ParameterLayout.of(problem), unknowns_of(calibration, len(POOL))
    line = linearise(unknowns, pool, layout, pool.detected)
    errors = []
    for pose in range(len(POOL)):
        gained = line.jacobians[pose].T @ np.linalg.inv(line.covariances[pose]) @ line.jacobians[pose]
        covariance = np.linalg.inv(np.linalg.inv(calibration.covariance) + gained)
        found = expected_error(unknowns, covariance, problem.image_sizes, problem.workspace)
        errors.append((found.triangulation_rms_mm, found.reprojection_rms_px))
    assert best.index == np.argmin([error[0] for error in errors])
    assert best.triangulation_mm[1] == pytest.approx(errors[best.index][0], rel=1e-4)
    assert best.reprojection_px[1] == pytest.approx(errors[best.index][1], rel=1e-4)
    assert best.triangulation_mm[0] == pytest.approx(calibration.expected.triangulation_rms_mm, rel=1e-9)


def test_poses_follow_on_each_other_and_none_comes_twice(known):
    calibration, problem, pool = known
    chosen = next_best_poses(calibration, problem, candidates_of(pool), 5)
    assert len({pose.name for pose in chosen}) == 5
    for one, other in pairwise(chosen):
        assert one.triangulation_mm[1] == other.triangulation_mm[0] > other.triangulation_mm[1]


def test_one_camera_alone_is_served_by_reprojection():
    whole = make_scene(Design(poses=34, cameras=1), 3).problem
    first = whole.taking(FIRST)
    best = next_best_poses(calibrate(first), first, candidates_of(whole.taking(POOL)))[0]
    assert np.isnan(best.triangulation_mm).all()
    assert best.reprojection_px[1] < best.reprojection_px[0]


def test_chosen_poses_beat_random_ones():
    found = further_poses(range(1, 4))
    assert found.chosen < 0.7 * found.random < found.before
    assert 0.6 < found.chosen / found.predicted < 1.5


def test_candidates_out_of_view_do_not_count(known):
    calibration, problem, pool = known
    hidden = replace(candidates_of(pool), positions=pool.positions + np.array([50.0, 0.0, 0.0]))
    with pytest.raises(DataError, match="1 poses are wanted, 0 of 20 candidates are in view"):
        next_best_poses(calibration, problem, hidden)


def pose_file(path, problem, **changes):
    poses = [
        {"name": name, "position_m": position.tolist(), "orientation_xyzw": [0.0, 0.0, 0.0, 1.0]}
        for name, position in zip(problem.pose_names, problem.positions, strict=True)
    ]
    path.write_text(yaml.safe_dump({"frame": "world", "poses": poses, **changes}))
    return path


def test_wrist_poses_become_led_positions(known, tmp_path):
    _, _, pool = known
    plain = replace(pool, joint_offset_prior_sd=0.0, joint_jacobians=None, led_offset_nominal=(0.0, 0.06, 0.05))
    found = load_candidates(pose_file(tmp_path / "poses.yaml", plain), plain)
    np.testing.assert_allclose(found.positions, plain.positions + np.array([0.0, 0.06, 0.05]))
    np.testing.assert_allclose(found.spot_covariances[:, 0], np.tile(0.01 * np.eye(2), (2, 1, 1)), atol=1e-12)


def test_a_pose_file_is_refused_by_line_and_name(known, tmp_path):
    _, problem, pool = known
    with pytest.raises(DataError, match=r"pose 14 needs J_joint, 3 rows of 6"):
        load_candidates(pose_file(tmp_path / "a.yaml", pool), problem)
    with pytest.raises(ConfigError, match="poses"):
        load_candidates(pose_file(tmp_path / "b.yaml", pool, poses=[]), problem)
    bent = [{"name": "x", "position_m": [0, 0, 1], "orientation_xyzw": [0, 0, 0, 2]}]
    with pytest.raises(ConfigError, match="unit quaternion"):
        load_candidates(pose_file(tmp_path / "c.yaml", pool, poses=bent), problem)


def test_the_command_says_when_what_it_counts_on_is_doubtful(tmp_path, capsys):
    scene = make_scene(Design(poses=8), 3)
    data, poses = tmp_path / "data.json", tmp_path / "poses.yaml"
    data.write_text(json.dumps(dataset_of(scene.problem)))
    pose = {"name": "a", "position_m": [0.1, 0.0, 1.1], "orientation_xyzw": [0.0, 0.0, 0.0, 1.0]}
    poses.write_text(json.dumps({"frame": "world", "poses": [pose]}))
    assert next_best_pose.main([str(data), str(poses)]) == 0
    told = capsys.readouterr()
    assert told.out.splitlines()[1].startswith("a ")
    assert "doubtful, for the data are: UNOBSERVABLE: camera_0 has" in told.err
