import copy
import json

import numpy as np
import pytest

from im_bringup.calibration.truth import add_to_report, truth_error
from im_cell.calibration_summary import brief_summary
from im_cell.robot.truth import CellTruth
from im_core.errors import DataError, NotFoundError

FACING_DOWN = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]


def camera(x):
    """A camera 4 m above the floor at (x, 0) that looks straight down."""
    centre = np.array([x, 0.0, 4.0])
    return {
        "K": [[400.0, 0.0, 320.0], [0.0, 400.0, 240.0], [0.0, 0.0, 1.0]],
        "D": [-0.1, 0.0, 0.0, 0.0, 0.0],
        "R_cam_base": FACING_DOWN,
        "t_cam_base_m": (-np.array(FACING_DOWN) @ centre).tolist(),
    }


TRUTH = CellTruth.model_validate(
    {
        "seed": 1,
        "cameras": {
            name: {**camera(x), "parent": parent, "width": 640, "height": 480}
            for name, x, parent in (("left", -0.5, "world"), ("right", 0.5, "world"), ("wrist", 0.0, "left_wrist"))
        },
        "leds": {"left_led": {"offset_m": [0.0, 0.06, 0.05], "axis": [0.0, 0.0, 1.0], "diameter_m": 0.02}},
        "laser": {
            "rotation": FACING_DOWN,
            "position_m": [0.0, 0.0, 4.0],
            "gain": [1.0, 1.0],
            "offset": 0.0,
            "gap_m": 0.02,
        },
    }
)


def report():
    return {
        "success": True,
        "cameras": [{"name": name, "rms_px": 0.1, **camera(x)} for name, x in (("left", -0.5), ("right", 0.5))],
        "led_offset_m": [0.0, 0.06, 0.051],
        "points_used": 40,
        "points_rejected": [],
        "chi2_per_dof": 1.0,
        "expected_error": {"triangulation_mm": 1.0, "reprojection_px": None},
        "timing": {"wall_s": 20.0, "simulated_s": 300.0},
    }


def test_the_truth_itself_has_no_error():
    error = truth_error(report(), TRUTH)
    assert error["triangulation_mm"] == pytest.approx(0.0, abs=1e-9)
    assert error["reprojection_px"] == pytest.approx(0.0, abs=1e-9)
    assert error["led_offset_mm"] == pytest.approx(1.0)


def test_a_shift_of_all_cameras_is_the_error_of_triangulation():
    shifted = report()
    for entry in shifted["cameras"]:
        entry["t_cam_base_m"][0] -= 0.003  # both cameras 3 mm further along x
    error = truth_error(shifted, TRUTH)
    assert error["triangulation_mm"] == pytest.approx(3.0, rel=1e-6)
    assert 0.2 < error["reprojection_px"] < 0.6  # 400 px x 3 mm / 3 m or so


def test_the_report_file_gets_it(tmp_path):
    path = tmp_path / "report.json"
    path.write_text(json.dumps(report()))
    add_to_report(path, TRUTH)
    read = json.loads(path.read_text())
    assert set(read["truth_error"]) == {"triangulation_mm", "reprojection_px", "led_offset_mm"}
    assert "true error       0.000 px reprojection, 0.000 mm triangulation" in brief_summary(read)
    assert [file.name for file in tmp_path.iterdir()] == ["report.json"]


def test_what_cannot_be_compared_is_refused(tmp_path):
    failed = {"success": False, "message": "too few points"}
    with pytest.raises(DataError, match="the report holds no calibration: too few points"):
        truth_error(failed, TRUTH)
    moving, strange = copy.deepcopy(report()), copy.deepcopy(report())
    moving["cameras"][0]["name"], strange["cameras"][0]["name"] = "wrist", "lft"
    with pytest.raises(DataError, match="camera 'wrist' is fixed to left_wrist and moves"):
        truth_error(moving, TRUTH)
    with pytest.raises(NotFoundError, match="did you mean 'left'"):
        truth_error(strange, TRUTH)
    with pytest.raises(DataError, match="is not a report"):
        add_to_report(tmp_path / "none.json", TRUTH)


def test_the_summary_is_short():
    text = brief_summary(report())
    assert "expected error   unknown px reprojection, 1.000 mm triangulation" in text
    assert "20.0 s for 300.0 s of the cell (15.0 times real time)" in text
    assert len(text.splitlines()) < 12
    alone = report()
    alone["expected_error"] = {"reprojection_px": 0.022, "triangulation_mm": None}
    assert "expected error   0.022 px reprojection, RMS over the workspace" in brief_summary(alone)
