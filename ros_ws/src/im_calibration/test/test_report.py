"""What is written about a calibration: complete, readable, whole."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from bench.calibration.synthetic import Design, make_scene
from im_calibration import calibrate, report_of, write_results
from im_cell.calibration_report import report_fields
from im_cell.calibration_summary import summary
from im_core.errors import DataError

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def solved():
    problem = make_scene(Design(outlier_share=0.1, missing_share=0.1, joint_offset_prior_sd=0.003), 1).problem
    return calibrate(problem), problem


@pytest.fixture(scope="module")
def failed():
    flat = np.random.default_rng(0).uniform((-1.0, -0.5, 1.0), (1.0, 0.5, 1.0), (40, 3))
    problem = make_scene(Design(cameras=1), 2, positions=flat).problem
    return calibrate(problem), problem


def test_the_report_holds_what_users_ask_for(solved):
    calibration, problem = solved
    report = json.loads(json.dumps(report_of(calibration, problem), allow_nan=False))
    assert report["success"] is True
    assert report["points_used"] == calibration.points_used
    assert len(report["points_not_seen"]) == (~problem.detected).sum()
    assert {"pose", "camera", "reason", "sigmas"} == set(report["points_rejected"][0])
    camera = report["cameras"][0]
    assert camera["name"] == "camera_0"
    np.testing.assert_allclose(camera["K"], calibration.cameras[0].model.K)
    assert len(camera["D"]) == 5
    assert np.shape(camera["R_cam_base"]) == (3, 3)
    assert np.shape(camera["covariance"]) == (14, 14)
    assert camera["standard_deviations"]["fx"] > 0.0
    expected = report["expected_error"]
    where = np.array(expected["map"]["points_m"])
    assert np.all((where > expected["workspace_low_m"]) & (where < expected["workspace_high_m"]))
    for name in ("triangulation_mm", "reprojection_px"):
        there = np.array(expected["map"][name], dtype=float)
        assert len(there) == len(where)
        assert np.sqrt(np.nanmean(there**2)) == pytest.approx(expected[name])
    assert report["verdicts"] == []
    assert len(report["joint_offsets_rad"]) == len(report["joint_offsets_standard_deviation_rad"]) == 6


def test_the_led_offset_is_the_nominal_one_corrected(solved):
    calibration, problem = solved
    report = report_of(calibration, replace(problem, led_offset_nominal=(0.0, 0.06, 0.05)))
    np.testing.assert_allclose(report["led_offset_m"], np.array([0.0, 0.06, 0.05]) + report["led_offset_error_m"])


def test_what_is_not_defined_is_null(failed):
    report = report_of(*failed)
    assert report["success"] is False
    assert report["expected_error"]["triangulation_mm"] is None
    assert report["verdicts"][0]["kind"] == "UNOBSERVABLE"


def test_the_summary_is_made_of_the_report(solved, failed):
    text = summary(report_of(*solved))
    for word in ("camera_0", "camera_1", "fx, fy [px]", "±", "LED offset [mm]", "joint offsets", "Rejected"):
        assert word in text
    alone = summary(report_of(*failed))
    assert "UNOBSERVABLE" in alone
    assert "mm triangulation" in text
    assert "triangulation" not in alone  # one camera has none


def test_a_good_calibration_is_written_whole(solved, tmp_path):
    target = tmp_path / "results" / "now"
    files = write_results(target, *solved)
    assert sorted(path.name for path in target.iterdir()) == sorted(path.name for path in files)
    for name in ("residuals.png", "coverage.png", "geometry.png"):
        content = (target / name).read_bytes()
        assert content.startswith(PNG)
        assert len(content) > 10_000
    assert json.loads((target / "report.json").read_text())["success"] is True
    camera = yaml.safe_load((target / "camera_0.yaml").read_text())
    assert camera["camera_name"] == "camera_0"
    assert camera["distortion_model"] == "plumb_bob"
    poses = yaml.safe_load((target / "extrinsics.yaml").read_text())["transforms"]
    for estimate, pose in zip(solved[0].cameras, poses, strict=True):
        assert (pose["header"]["frame_id"], pose["child_frame_id"]) == ("world", f"{estimate.name}_optical_frame")
        assert list(pose["transform"]["translation"].values()) == pytest.approx(list(estimate.model.position))


def test_a_failed_calibration_leaves_no_camera_files(failed, tmp_path):
    write_results(tmp_path, *failed)
    assert not list(tmp_path.glob("*.yaml"))
    assert (tmp_path / "geometry.png").read_bytes().startswith(PNG)
    assert json.loads((tmp_path / "report.json").read_text())["success"] is False


def test_camera_files_of_a_former_calibration_are_taken_away(solved, failed, tmp_path):
    """And no others: whoever starts with the directory gets the cameras of its report."""
    (tmp_path / "poses.yaml").write_text("mine: 1\n")
    write_results(tmp_path, *solved)
    assert {path.name for path in tmp_path.glob("camera_*.yaml")} == {"camera_0.yaml", "camera_1.yaml"}
    one = make_scene(Design(cameras=1), 5).problem
    write_results(tmp_path, calibrate(one), one)
    assert sorted(path.name for path in tmp_path.glob("*.yaml")) == [
        "camera_0.yaml",
        "covariance.yaml",
        "extrinsics.yaml",
        "poses.yaml",
    ]
    write_results(tmp_path, *failed)
    assert [path.name for path in tmp_path.glob("*.yaml")] == ["poses.yaml"]
    assert json.loads((tmp_path / "report.json").read_text())["success"] is False


def test_a_directory_that_cannot_be_written_is_named(solved, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("here")
    with pytest.raises(DataError, match=r"cannot be written to .*file"):
        write_results(blocked, *solved)


def test_the_message_tells_what_the_report_does(solved, failed):
    for calibration, problem in (solved, failed):
        report = json.loads(json.dumps(report_of(calibration, problem), allow_nan=False))
        fields = report_fields(report)
        assert json.loads(fields["json"]) == report
        assert fields["verdicts"] == [str(verdict) for verdict in calibration.verdicts]
        rejected = [(each["pose"], each["camera"], each["reason"]) for each in fields["points_rejected"]]
        assert rejected == [(each.pose, each.camera, each.reason) for each in calibration.rejections]
        np.testing.assert_equal(fields["expected_reprojection"], calibration.expected.reprojection_rms_px)
        assert np.isnan([fields["scale_error"], fields["scale_sd"]]).all()
        for told, camera in zip(fields["cameras"], calibration.cameras, strict=True):
            np.testing.assert_array_equal(told["k"], camera.model.K.ravel())
            np.testing.assert_array_equal(told["r_cam_base"], camera.model.R_cam_base.ravel())
            finite = np.all(np.isfinite(camera.covariance))
            np.testing.assert_array_equal(told["covariance"], camera.covariance.ravel() if finite else [])
    for spoilt in ({"success": True}, {**report, "cameras": None}, {**report, "scale": 3}):
        with pytest.raises(DataError, match="the report of the calibration is not whole"):
            report_fields(spoilt)
