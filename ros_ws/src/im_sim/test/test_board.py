"""A printed chessboard in the cell, seen by the camera on the wrist: calibrated from its images, against the truth."""

import json

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from bench.vss.cameras import simulated
from im_calibration.commands.calibrate_dataset import main
from im_cell.camera_model import CameraModel
from im_cell.link import Exposure
from im_cell.robot import Target, load_cell
from im_sim.cameras.bank import CameraBank
from im_sim.cameras.scene import SceneMirror
from im_vss.settings import load_settings

CELL = load_cell()
SETTINGS = load_settings(CELL)
CAMERA, WRIST, VIEWS, SIDE_M, DISTANCE_M, SD_M = "wrist_left", "left_wrist", 12, 0.03, 0.5, 2e-4


def in_world(true, wrist):
    """The true camera of the wrist, in the world."""
    rotation, origin = wrist
    R = np.array(true.R_cam_base) @ rotation.T
    return CameraModel(true.width, true.height, np.array(true.K), np.array(true.D), R, true.t_cam_base_m - R @ origin)


def test_a_board_calibrates_the_camera_of_the_wrist(tmp_path, make_truth):
    rng, truth, scene = np.random.default_rng(2), make_truth(CELL), SceneMirror(CELL, "tiny")
    true = truth.cameras[CAMERA]
    scene.set_joints(CELL.home)
    here = in_world(true, scene.pose(WRIST))
    axes = here.R_cam_base.T
    board = Target(
        name="board", kind="chessboard", corners=(8, 5), size=SIDE_M, plate=0.34, normal=tuple(-axes[:, 2]),
        up=tuple(-axes[:, 1]), position=tuple(here.position + DISTANCE_M * axes[:, 2]),
    )  # fmt: skip
    rotation, middle = board.pose()
    rim = middle + np.array([[x, y, 0.0] for x in (-0.15, 0.15) for y in (-0.1, 0.1)]) @ rotation.T
    bank = CameraBank(CELL.model_copy(update={"targets": (board,)}), truth, simulated(SETTINGS), scene, seed=1)
    (tmp_path / CAMERA).mkdir()
    lines, seen = [], 0
    while seen < VIEWS:
        q = CELL.home + np.pad(rng.uniform(-0.5, 0.5, 9), (0, 9))
        scene.set_joints(q)
        wrist = scene.pose(WRIST)
        camera = in_world(true, wrist)
        if camera.to_camera(rim)[:, 2].min() < 0.3 or (camera.R_cam_base @ rotation)[2, 2] > -0.6:
            continue
        uv = camera.project(rim)
        if uv.min() < 10.0 or np.any(uv > (camera.width - 10.0, camera.height - 10.0)):
            continue
        exposure = Exposure(10, 14, stamp_ns=0, q_true=q, light_fraction={"left_led": 0.0, "right_led": 0.0})
        mean = bank.expected(CAMERA, exposure, SETTINGS.exposure.nominal, SETTINGS.sensor)
        image = np.zeros(mean.shape, np.uint8)
        bank.read_out(CAMERA, mean, seen, 0, image, SETTINGS.sensor)
        cv2.imwrite(str(tmp_path / CAMERA / f"view{seen:02d}.png"), image)
        place = wrist[1] + rng.normal(0.0, SD_M, 3)
        numbers = (*place, *Rotation.from_matrix(wrist[0]).as_quat())
        lines.append(f"view{seen:02d} " + " ".join(f"{number:.9f}" for number in numbers))
        seen += 1
    scene.close()
    (tmp_path / "poses.txt").write_text("\n".join(lines) + "\n")
    options = ["--target", "chessboard:8x5:30mm", "--results", str(tmp_path / "results"), "--eye-in-hand"]
    robot = ["--robot", str(tmp_path / "poses.txt"), "--order", "xyzw"]
    assert main(["--images", f"{CAMERA}={tmp_path / CAMERA}", *options, *robot]) == 0
    report = json.loads((tmp_path / "results" / "report.json").read_text())
    (found,) = report["cameras"]
    sd = found["standard_deviations"]
    assert np.abs(np.array(found["K"]) - true.K).max() < 6.0 * max(sd["fx"], sd["cx"], sd["cy"])
    off = np.array(found["t_cam_base_m"]) - true.t_cam_base_m
    assert np.all(np.abs(off) < 6.0 * np.array([sd[name] for name in ("tx", "ty", "tz")]))
    assert max(sd["tx"], sd["ty"], sd["tz"]) < 5e-3
