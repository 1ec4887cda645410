"""``calibrate_camera --target board``: cameras of a whole machine by a chessboard on the wrist; truth is asked last."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import yaml

from im_bringup.calibration.truth import truth_error
from im_cell.robot import load_cell
from im_cell.robot.truth import CellTruth
from im_core.config import package_file
from support.whole_machine import COMMAND_S, run_script, running_machine

pytestmark = pytest.mark.end_to_end

CEILING = ["ceiling_left", "ceiling_right"]
BOARD, POSES = (package_file("im_cell", f"cells/puma_pair/{name}") for name in ("board.yaml", "board_24.yaml"))


@pytest.fixture(scope="module")
def machine():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IM_OBJECTS", str(BOARD))
        with running_machine() as machine:
            yield machine


@pytest.fixture(scope="module")
def poses(tmp_path_factory):
    """Fourteen of the shipped poses."""
    content = yaml.safe_load(POSES.read_text())
    content["poses"] = content["poses"][:14]
    path = tmp_path_factory.mktemp("poses") / "board_14.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_cameras_are_calibrated_by_a_board_whose_place_on_the_wrist_nobody_tells(machine, poses):
    from std_msgs.msg import String

    from im_core.ros import qos
    from im_msgs.srv import CalibrateCamera, GetTruth

    lights = []
    machine.node.create_subscription(String, "/testbed/lights", lights.append, qos.LATCHED)
    refused = machine.call(CalibrateCamera, "/dispatcher/calibrate_camera", target="lamp")
    assert "argument target is 'lamp', not one of" in refused.message
    refused = machine.call(CalibrateCamera, "/dispatcher/calibrate_camera", accuracy=-1.0)
    assert "argument accuracy is -1" in refused.message
    asked = {"target": "board", "poses_file": str(poses)}
    done = machine.call(CalibrateCamera, "/dispatcher/calibrate_camera", COMMAND_S, **asked)
    assert done.success, done.message
    folder = Path(os.environ["IM_RESULTS_DIR"]) / "latest"
    assert folder.resolve() == Path(done.report.directory).resolve()
    report = json.loads((folder / "report.json").read_text())
    assert [camera["name"] for camera in report["cameras"]] == CEILING
    assert report["board"] == "board"
    assert lights
    assert not any(any(json.loads(told.data).values()) for told in lights), "a board needs no light"

    assert {f"{name}.yaml" for name in CEILING} | {"residuals.png", "coverage.png", "geometry.png"} <= set(
        os.listdir(folder)
    )
    observations = json.loads((folder / "observations.json").read_text())
    truth = CellTruth.model_validate(json.loads(machine.call(GetTruth, "/testbed/get_truth").json))
    error, expected = truth_error(report, observations, truth, load_cell()), report["expected_error"]
    assert 0.1 < error["triangulation_mm"] / expected["triangulation_mm"] < 2.5
    assert 0.1 < error["reprojection_px"] / expected["reprojection_px"] < 2.5
    for camera in report["cameras"]:
        true, sd = truth.cameras[camera["name"]], camera["standard_deviations"]
        for name, row, column in (("fx", 0, 0), ("fy", 1, 1), ("cx", 0, 2), ("cy", 1, 2)):
            assert abs(camera["K"][row][column] - true.K[row][column]) < 4.5 * sd[name]
        assert sd["fx"] < 0.5

    (board,) = (target for target in load_cell(None).targets if target.name == "board")
    place, covariance = np.array(report["target"]["transform"]), np.array(report["target"]["covariance"])
    rotation, middle = board.pose()
    columns, rows = board.corners
    drawn = middle + rotation @ (0.5 * board.size * np.array([1 - columns, rows - 1, 0]))
    assert np.linalg.norm(place[:3, 3] - drawn) < 3e-3, "as the cell has it, but for the errors of the arm"
    assert np.sqrt(np.diag(covariance)[3:]).max() < 1e-3

    again = run_script("im", "calibrate", "--again", folder)
    assert again.returncode == 0, again.stderr
    same = json.loads((folder / "again" / "report.json").read_text())
    assert same["chi2"] == pytest.approx(report["chi2"], rel=1e-6)


def test_what_no_board_can_do_is_refused_before_anything_moves(machine):
    """Of the poses that the board's own file names."""
    on_the_arm = machine.execute("calibrate_camera", target="board", cameras=["wrist_left"])()
    assert "camera wrist_left is on the left arm, as board is" in on_the_arm.status.message
    accurate = machine.execute("calibrate_camera", target="board", accuracy=3e-4)()
    assert "an accuracy is for target light" in accurate.status.message
    other = machine.execute("calibrate_camera", target="board", group="right")()
    assert "the poses are those of the left arm" in other.status.message
