"""Free bodies and jaws in the images."""

from dataclasses import replace

import numpy as np
import pytest

from bench.vss.cameras import simulated
from im_calibration.targets.detection import detect
from im_calibration.targets.target import chessboard_of
from im_cell.camera_model import CameraModel
from im_cell.link import Exposure
from im_cell.robot import load_cell
from im_core.config import package_file
from im_sim.cameras.bank import CameraBank
from im_sim.cameras.plates import in_world
from im_sim.cameras.scene import SceneMirror
from im_vss.settings import load_settings


@pytest.fixture
def seen(monkeypatch, make_truth):
    """The cell, a function of an exposure to the image of a ceiling camera, and the true camera."""
    monkeypatch.setenv("IM_OBJECTS", str(package_file("im_cell", "cells/puma_pair/objects.yaml")))
    cell = load_cell()
    settings = load_settings(cell)
    truth, scene = make_truth(cell), SceneMirror(cell, "tiny")
    bank = CameraBank(cell, truth, simulated(settings), scene, seed=1)
    true = truth.cameras["ceiling_left"]
    camera = CameraModel(640, 480, true.K, true.D, true.R_cam_base, true.t_cam_base_m)
    yield (
        cell,
        lambda exposure: bank.expected("ceiling_left", exposure, settings.exposure.nominal, settings.sensor),
        camera,
    )
    scene.close()


def test_a_body_is_seen_where_it_lies_with_its_print_and_moves_away(seen):
    cell, image, camera = seen
    bodies = np.array([body.start for body in cell.objects])
    there = Exposure(10, 14, 0, cell.home, {}, bodies=bodies, jaws=np.full(2, 0.08))
    rank = [body.name for body in cell.objects].index("tagged_plate")
    plate = cell.objects[rank]
    top = bodies[rank, :3] + (0.0, 0.0, plate.size[2] / 2)
    u, v = np.rint(camera.project(top)).astype(int)
    gone = bodies.copy()
    gone[rank, 0] += 0.3
    print_of, table = (image(each)[v - 8 : v + 9, u - 8 : u + 9] for each in (there, replace(there, bodies=gone)))
    assert np.ptp(print_of) > 3.0 * np.ptp(table), "a code has black and white, the table under it has neither"
    again = image(there)[v - 8 : v + 9, u - 8 : u + 9]
    assert np.array_equal(again, print_of), "as before, once it is back"


def test_jaws_are_seen_open_and_closed(seen):
    cell, image, _ = seen
    bodies = np.array([body.start for body in cell.objects])
    wide, shut = (Exposure(10, 14, 0, cell.home, {}, bodies=bodies, jaws=np.full(2, w)) for w in (0.08, 0.0))
    assert np.count_nonzero(np.abs(image(wide) - image(shut)) > 2.0) > 5


def test_a_board_moves_with_the_wrist_that_carries_it(monkeypatch, make_truth):
    """It is found where forward kinematics and the true camera put it; in front of it the light is hidden."""
    monkeypatch.setenv("IM_OBJECTS", str(package_file("im_cell", "cells/puma_pair/board.yaml")))
    cell = load_cell()
    settings, truth, scene = load_settings(cell), make_truth(cell), SceneMirror(cell, "tiny")
    true, board = truth.cameras["ceiling_left"], cell.board_of("left")
    camera = CameraModel(640, 480, true.K, true.D, true.R_cam_base, true.t_cam_base_m)
    bank = CameraBank(cell, truth, simulated(settings), scene, seed=1)
    points = chessboard_of(cell, "board").points[:, :2] * (1.0, -1.0)
    points -= points.mean(axis=0)
    places, rng = [], np.random.default_rng(5)
    while len(places) < 2:
        q = cell.home + np.pad(rng.uniform(-1.5, 1.5, 9), (0, 9))
        scene.set_joints(q)
        rotation, position = in_world(board, scene.pose)
        towards = (camera.position - position) / np.linalg.norm(camera.position - position)
        there = camera.project(position + 1.5 * points @ rotation[:, :2].T)
        if rotation[:, 2] @ towards < 0.8 or not 0.9 < position[2] < 2.5 or not camera.contains(there, 5.0).all():
            continue
        exposure = Exposure(10, 14, 0, q, {"left_led": 1.0, "right_led": 0.0})
        mean = bank.expected("ceiling_left", exposure, settings.exposure.nominal, settings.sensor)
        found = detect(np.clip(mean, 0, 255).astype(np.uint8), chessboard_of(cell, "board"))
        assert found is not None
        there = camera.project(position + points @ rotation[:, :2].T)
        np.testing.assert_allclose(found.points, there, atol=0.1)
        assert bank.spot("ceiling_left", "left_led") is None
        places.append(there)
    assert np.abs(places[0] - places[1]).max() > 5.0
    scene.close()
