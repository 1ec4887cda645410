"""Free bodies and jaws in the images."""

from dataclasses import replace

import numpy as np
import pytest

from bench.vss.cameras import simulated
from im_cell.camera_model import CameraModel
from im_cell.link import Exposure
from im_cell.robot import load_cell
from im_core.config import package_file
from im_sim.cameras.bank import CameraBank
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
