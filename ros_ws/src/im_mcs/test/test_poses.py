"""The command ``poses``: what it writes, for cameras under the ceiling, near the table and on an arm."""

import numpy as np
import pinocchio as pin
import pytest
import yaml

from im_cell.camera_model import CameraModel
from im_cell.robot import load_cell
from im_core.config import package_file
from im_mcs.client.kinematics import Kinematics
from im_mcs.collision import CollisionChecker
from im_mcs.poses.command import main

PAIRS = {"left": ("wall", "table"), "right": ("wrist_left", "ceiling_right")}
COUNT = 8


@pytest.fixture(scope="module", params=PAIRS)
def poses(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("poses") / "poses.yaml"
    assert main(["--cameras", *PAIRS[request.param], "--count", str(COUNT), "--output", str(path)]) == 0
    found = yaml.safe_load(path.read_text())
    assert found["group"] == request.param
    return found


def wrists(poses):
    for pose in poses["poses"]:
        x, y, z, w = pose["orientation_xyzw"]
        yield pin.SE3(pin.Quaternion(w, x, y, z).matrix(), np.array(pose["position_m"]))


def camera_at_home(model, name):
    """The nominal camera in the world, all joints at home."""
    camera = model.cell.cameras[name]
    rotation, translation = camera.pose()
    mount = pin.SE3.Identity() if camera.parent == "world" else model.pose(model.cell.home, camera.parent)
    placed = pin.SE3(rotation, translation) * mount.inverse()
    lens = camera.intrinsics
    K = np.array([[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]])
    return CameraModel(lens.width, lens.height, K, np.zeros(5), placed.rotation, placed.translation)


def test_ways_from_one_pose_to_the_next_are_free_and_the_light_is_not_hidden(poses, config, model):
    kinematics, cell, group = Kinematics(config, model), model.cell, poses["group"]
    index = [model.index(joint) for joint in config.groups[group].joints]
    cameras = [camera_at_home(model, name) for name in PAIRS[group]]
    checker, q = CollisionChecker(model, config.collision.clearance_m), cell.home
    for pose in poses["poses"]:
        kinematics.check_path(group, [q[index].tolist(), pose["joints"]], q)
        q[index] = pose["joints"]
        light = model.pose(q, f"{group}_wrist").act(np.array(cell.led.offset))
        for camera in cameras:
            towards = (camera.position - light) / np.linalg.norm(camera.position - light)
            assert checker.blocking(q, light + 0.03 * towards, camera.position, 0.01) is None


def test_poses_may_be_visited_in_any_order_for_each_has_its_joints(poses, config, model):
    assert poses["order"] == "free"
    q, group = model.cell.home, poses["group"]
    index = [model.index(joint) for joint in config.groups[group].joints]
    for pose, wrist in zip(poses["poses"], wrists(poses), strict=True):
        q[index] = pose["joints"]
        off = model.pose(q, config.groups[group].wrist).actInv(wrist)
        assert np.linalg.norm(pin.log6(off).vector) < 1e-3


def test_the_light_shines_into_the_images_of_all_cameras(poses, model):
    led = model.cell.led
    for wrist in wrists(poses):
        light, outward = wrist.act(np.array(led.offset)), wrist.rotation @ np.array(led.axis)
        for name in PAIRS[poses["group"]]:
            camera = camera_at_home(model, name)
            towards = camera.position - light
            assert camera.contains(camera.project(light), margin=10.0), name
            assert np.arccos(outward @ towards / np.linalg.norm(towards)) < led.half_angle


def test_lights_are_apart_and_the_wrist_turns(poses, model):
    lights = np.array([wrist.act(np.array(model.cell.led.offset)) for wrist in wrists(poses)])
    between = np.linalg.norm(lights[:, None] - lights, axis=2) + 9.0 * np.eye(COUNT)
    side = np.prod(np.ptp(lights, axis=0)) ** (1 / 3)
    assert between.min() > 0.35 * side / COUNT ** (1 / 3)
    mean = np.mean([wrist.rotation for wrist in wrists(poses)], axis=0)
    assert np.linalg.norm(mean, 2) < 0.9  # no axis of the wrist keeps its direction


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--group", "lefft"], "there is no group 'lefft'; did you mean 'left'"),
        (["--cameras", "ceiling"], "there is no camera 'ceiling'"),
        (["--cameras", "wall", "wall"], "camera 'wall' is given twice"),
        (["--group", "left", "--cameras", "wrist_left"], "'wrist_left' rides on left_wrist, which group 'left' moves"),
    ],
)
def test_mistakes_are_named(capsys, arguments, message):
    assert main(arguments) == 1
    told = capsys.readouterr().err
    assert told.startswith("poses: ")
    assert message in told


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--count", "0"], "0 is no whole number from 1 on"),
        (["--seed=-1"], "-1 is no whole number from 0 on"),
        (["--tilt", "nan"], "nan is not a finite number"),
        (["--tilt=-40"], "-40 is no angle from 0 to 180 deg"),
    ],
)
def test_numbers_that_cannot_be_are_bad_usage(capsys, arguments, message):
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    assert message in capsys.readouterr().err


def test_a_board_on_the_wrist_is_whole_in_the_images_and_its_squares_are_large(tmp_path, monkeypatch, model):
    monkeypatch.setenv("IM_OBJECTS", str(package_file("im_cell", "cells/puma_pair/board.yaml")))
    path = tmp_path / "poses.yaml"
    assert main(["--target", "board", "--cameras", "wall", "--count", "3", "--output", str(path)]) == 0
    board, camera = load_cell().board_of("left"), camera_at_home(model, "wall")
    rotation, middle = board.pose()
    half = 0.5 * board.size * (np.array(board.corners) + 1.0)
    for wrist in wrists(yaml.safe_load(path.read_text())):
        rim = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
        seen = camera.project([wrist.act(middle + rotation[:, :2] @ place) for place in rim])
        assert camera.contains(seen, margin=19.0).all()
        sides = np.linalg.norm(np.roll(seen, -1, axis=0) - seen, axis=1) / np.tile(np.array(board.corners) + 1.0, 2)
        assert sides.min() > 4.5, "nominal 6 px in the middle of the board"
    assert main(["--target", "board", "--group", "right", "--cameras", "wall"]) == 1
