import copy
import json

import numpy as np
import pytest

from im_bringup.calibration.truth import add_to_report, arms_off, place_of, require_cell, truth_error
from im_cell.calibration_summary import brief_summary
from im_cell.robot import kinematic_derivatives, load_cell
from im_cell.robot.truth import CellTruth, errors_of
from im_core.errors import DataError, NotFoundError
from im_sim.truth import draw_truth

CELL = load_cell()
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
        "light": "left_led",
        "chi2_per_dof": 1.0,
        "expected_error": {"triangulation_mm": 1.0, "reprojection_px": None},
        "timing": {"wall_s": 20.0, "simulated_s": 300.0},
    }


POSITIONS = np.random.default_rng(1).uniform((-0.2, 0.5, 0.6), (0.6, 1.3, 1.4), (12, 3))


def observations(joints=CELL.home):
    """Of an arm whose joints are anywhere near some positions, with the light anywhere: derivatives are of both."""
    near = np.random.default_rng(2).uniform(-0.4, 0.4, (12, len(joints))) + joints
    at = [dict(zip(CELL.joint_names, each.tolist(), strict=True)) for each in near]
    jacobians = [kinematic_derivatives(CELL, "left_wrist", each, np.array(CELL.led.offset)).tolist() for each in at]
    return {"J_arm": jacobians, "trials": [{"x_base_m": POSITIONS.tolist()}]}


def off_drawing(seed):
    """The truth with arms off their drawing, and how far the light is off in the observations."""
    joints = draw_truth(CELL, seed).joints
    off = np.array(observations()["J_arm"]) @ errors_of(CELL, "left_wrist", joints)
    return TRUTH.model_copy(update={"joints": joints}), off


def test_a_free_body_is_told_by_place_turn_and_tilt():
    objects = {"part": (0.5, 1.0, 0.88, 0.0, 0.0, np.sin(0.2), np.cos(0.2)), "can": (0.0, 0.0, 0.1, 0.5, 0.5, 0.5, 0.5)}
    truth = TRUTH.model_copy(update={"objects": objects})
    told = "part at (0.5000, 1.0000, 0.8800) m, turned by 22.9 and tilted by 0.0 degrees"
    assert place_of("part", truth) == told
    assert "tilted by 90.0 degrees" in place_of("can", truth)
    with pytest.raises(NotFoundError, match="there is no object 'cup'"):
        place_of("cup", truth)


def test_the_truth_itself_has_no_error():
    error = truth_error(report(), observations(), TRUTH, CELL)
    assert error["triangulation_mm"] == pytest.approx(0.0, abs=1e-9)
    assert error["reprojection_px"] == pytest.approx(0.0, abs=1e-9)
    assert error["led_offset_mm"] == pytest.approx(1.0)


def test_a_shift_of_all_cameras_is_the_error_of_triangulation():
    shifted = report()
    for entry in shifted["cameras"]:
        entry["t_cam_base_m"][0] -= 0.003  # both cameras 3 mm further along x
    error = truth_error(shifted, observations(), TRUTH, CELL)
    assert error["triangulation_mm"] == pytest.approx(3.0, rel=1e-6)
    assert 0.2 < error["reprojection_px"] < 0.6  # 400 px x 3 mm / 3 m or so


def test_what_is_common_to_all_positions_of_an_arm_is_no_error_of_a_camera():
    truth, off = off_drawing(3)
    turn = pin_down(POSITIONS, off)
    found = report()
    for entry in found["cameras"]:
        R, t = np.array(entry["R_cam_base"]), np.array(entry["t_cam_base_m"])
        entry["R_cam_base"], entry["t_cam_base_m"] = (R @ turn[:, :3]).tolist(), (R @ turn[:, 3] + t).tolist()
    assert truth_error(found, observations(), truth, CELL)["triangulation_mm"] < 0.02
    assert truth_error(report(), observations(), truth, CELL)["triangulation_mm"] > 0.1
    assert truth_error(report(), observations(), TRUTH, CELL)["triangulation_mm"] < 1e-6


def pin_down(positions, off):
    """Turn and shift of positions onto those that are off, shape (3, 4), by Kabsch's method."""
    there, mean, moved = positions + off, positions.mean(axis=0), (positions + off).mean(axis=0)
    u, _, vt = np.linalg.svd((there - moved).T @ (positions - mean))
    R = u @ np.diag((1.0, 1.0, np.linalg.det(u @ vt))) @ vt
    return np.column_stack((R, moved - R @ mean))


def test_the_arms_are_told_with_how_far_they_are_off():
    truth, _ = off_drawing(3)
    first, left, right = arms_off(truth, CELL).splitlines()
    assert first.startswith("off the drawing")
    for line, name in ((left, "left"), (right, "right")):
        told, size, *_ = line.split()
        assert told == f"{name}:"
        assert 0.1 < float(size) < 2.0
    assert "left: 0.00 mm RMS, 0.00 mm at most" in arms_off(TRUTH, CELL)


def test_the_report_file_gets_it(tmp_path):
    path = tmp_path / "report.json"
    path.write_text(json.dumps(report()))
    with pytest.raises(DataError, match=r"observations\.json is not observations"):
        add_to_report(path, TRUTH, CELL)
    (tmp_path / "observations.json").write_text(json.dumps(observations()))
    add_to_report(path, TRUTH, CELL)
    read = json.loads(path.read_text())
    assert set(read["truth_error"]) == {"triangulation_mm", "reprojection_px", "led_offset_mm"}
    assert "true error       0.000 px reprojection, 0.000 mm triangulation" in brief_summary(read)
    assert {file.name for file in tmp_path.iterdir()} == {"observations.json", "report.json"}


def test_what_cannot_be_compared_is_refused(tmp_path):
    failed = {"success": False, "message": "too few points"}
    with pytest.raises(DataError, match="the report holds no calibration: too few points"):
        truth_error(failed, observations(), TRUTH, CELL)
    moving, strange = copy.deepcopy(report()), copy.deepcopy(report())
    moving["cameras"][0]["name"], strange["cameras"][0]["name"] = "wrist", "lft"
    with pytest.raises(DataError, match="camera 'wrist' is fixed to left_wrist and moves"):
        truth_error(moving, observations(), TRUTH, CELL)
    with pytest.raises(NotFoundError, match="did you mean 'left'"):
        truth_error(strange, observations(), TRUTH, CELL)
    with pytest.raises(NotFoundError, match="there is no light 'lamp'"):
        truth_error({**report(), "light": "lamp"}, observations(), TRUTH, CELL)
    with pytest.raises(DataError, match="the report holds no observations: J_arm"):
        truth_error(report(), {"trials": []}, TRUTH, CELL)
    with pytest.raises(DataError, match="J_arm of the observations is not 12 x 3 x 86 numbers"):
        truth_error(report(), {**observations(), "J_arm": [[[0.1], [0.1], [0.1, 0.2]]] * 12}, TRUTH, CELL)
    with pytest.raises(DataError, match="is not a report"):
        add_to_report(tmp_path / "none.json", TRUTH, CELL)


@pytest.mark.parametrize(("perfect", "first"), [(False, "shoulder_pan_joint"), (True, "arm_led")])
def test_the_truth_of_another_cell_is_refused(perfect, first):
    truth = draw_truth(load_cell("ur5"), 1, perfect_arm=perfect)
    require_cell(truth, load_cell("ur5"))
    with pytest.raises(DataError, match=f"has not what the testbed has, {first}, .*: IM_CELL names that of"):
        require_cell(truth, CELL)


def test_the_summary_is_short():
    text = brief_summary(report())
    assert "expected error   unknown px reprojection, 1.000 mm triangulation" in text
    assert "20.0 s for 300.0 s of the cell (15.0 times real time)" in text
    assert len(text.splitlines()) < 12
    alone = report()
    alone["expected_error"] = {"reprojection_px": 0.022, "triangulation_mm": None}
    assert "expected error   0.022 px reprojection, RMS over the workspace" in brief_summary(alone)
