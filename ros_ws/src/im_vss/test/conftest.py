"""A camera above the table with its printed plates."""

from dataclasses import dataclass

import numpy as np
import pytest

from bench.vss.cameras import drawn_truth, simulated
from im_cell.camera_model import CameraModel
from im_cell.link import Exposure
from im_cell.robot import load_cell
from im_sim.cameras.bank import CameraBank
from im_sim.cameras.scene import SceneMirror
from im_vss.settings import load_settings
from support.fixtures import make_truth

__all__ = ["make_truth"]


@dataclass
class Plates:
    """What the camera sees; its model is the true one."""

    cell: object
    settings: object
    bank: CameraBank
    camera: CameraModel
    mean: np.ndarray

    def image(self, number):
        """An image with noise of its own."""
        out = np.zeros((480, 640), np.uint8)
        self.bank.read_out("ceiling_left", self.mean, number, 0, out, self.settings.sensor)
        return out


@pytest.fixture(scope="session")
def plates():
    cell = load_cell()
    settings, truth = load_settings(cell), drawn_truth(cell)
    scene = SceneMirror(cell, "tiny")
    bank = CameraBank(cell, truth, simulated(settings), scene, seed=1)
    dark = Exposure(start_tick=0, end_tick=4, stamp_ns=0, q_true=cell.home, light_fraction={})
    mean = bank.expected("ceiling_left", dark, settings.exposure.nominal, settings.sensor)
    true = truth.cameras["ceiling_left"]
    camera = CameraModel(640, 480, true.K, true.D, true.R_cam_base, true.t_cam_base_m)
    yield Plates(cell, settings, bank, camera, mean)
    scene.close()
