"""Cameras that are calibrated where an arm holds them."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from im_calibration import Observation, SeenSpot
from im_cell.camera_covariance import CameraCovariance
from im_cell.camera_model import PARAMETERS, CameraModel
from im_cell.frames import Frame, FrameSet, nobody
from im_cell.robot import load_cell
from im_core.errors import StateError
from im_vss.camera_book import CameraBook
from im_vss.camera_poses import MOST_EXPOSURES, Mounts
from im_vss.catalogue import load_catalogue
from im_vss.rig import Rig
from im_vss.services.calibrate import CalibrateRequest, fixed_to
from im_vss.services.snap import SnapRequest
from im_vss.settings import load_settings
from im_vss.vsm import VisionServicesManager

CELL = load_cell()
CAMERA, WRIST = "wrist_left", "left_wrist"


def test_a_camera_on_an_arm_sees_the_same_from_its_mount():
    turned, mount = Rotation.random(2, random_state=3)
    K = np.array([[600.0, 0.0, 320.0], [0.0, 601.0, 240.0], [0.0, 0.0, 1.0]])
    camera = CameraModel(
        640, 480, K, np.array([-0.2, 0.05, 1e-3, -1e-3, 0.0]), turned.as_matrix(), np.array([0.1, -0.4, 2.0])
    )
    origin = np.array([0.7, -0.2, 1.1])
    in_mount = np.random.default_rng(4).uniform(-0.5, 0.5, (50, 3)) + 0.3
    in_world = mount.apply(in_mount) + origin
    ahead = camera.to_camera(in_world)[:, 2] > 0.1
    assert ahead.sum() > 10
    seen = fixed_to(camera, mount.as_matrix(), origin).project(in_mount[ahead])
    np.testing.assert_allclose(seen, camera.project(in_world[ahead]), atol=1e-9)


class Arm:
    """Holds the camera somewhere; its pose is known but at some times [ns]."""

    def __init__(self, cameras=None):
        self.x, self.unknown, self.cameras = 0.3, set(), cameras

    def now(self, frame, stamp_ns):
        assert frame == WRIST
        return None if stamp_ns in self.unknown else (np.eye(3), np.array([self.x, 0.0, 0.0]))


class Cameras:
    """Expose at once, at 1000 ns, 2000 ns, ...; what moves before the images are there is in none."""

    def __init__(self):
        self.shut, self.tells, self.move_on = 0, True, lambda: None

    def take_frames(self, order, exposed=nobody):
        self.shut += 1
        if self.tells:
            exposed((1000 * self.shut,))
        self.move_on()
        black = np.zeros((480, 640), np.uint8)
        frames = {camera: (Frame(camera, black, 1000 * self.shut, False),) for camera in order.cameras}
        return FrameSet(frames, {}, order.exposure_s)


@pytest.fixture
def held(tmp_path, monkeypatch):
    """The Services with an arm, and a calibration of its camera from exposures at some times [ns]; where that puts it.

    The solver finds it at the origin of the world.
    """
    arm, settings = Arm(Cameras()), load_settings(CELL)
    screen = SimpleNamespace(raw=lambda frame: None, display=lambda *_: None, residuals=lambda *_: None)
    book, mounts = CameraBook(CELL, settings.cameras, tmp_path), Mounts(arm.now)
    rig = Rig(settings, CELL, book, arm.cameras, screen, mounts=mounts)
    vsm = VisionServicesManager(rig, load_catalogue())
    model = CameraModel(640, 480, rig.book[CAMERA].model.K, np.zeros(5), np.eye(3), np.zeros(3))
    known = CameraCovariance(tuple(f"{CAMERA}.{name}" for name in PARAMETERS), np.eye(len(PARAMETERS)))
    camera = SimpleNamespace(name=CAMERA, model=model)
    found = SimpleNamespace(usable=True, cameras=(camera,), camera_covariance=known, residuals=([],))
    monkeypatch.setattr("im_vss.modules.solver.calibrate_possible", lambda problem: found)
    monkeypatch.setattr("im_vss.services.calibrate.report_of", lambda *_: {})

    def snap(x):
        arm.x = x
        vsm.request("snap", SnapRequest(("wall", CAMERA)))

    def calibrated(*stamps_ns):
        seen = [{CAMERA: SeenSpot(np.array([320.0, 240.0]), np.eye(2), stamp_ns)} for stamp_ns in stamps_ns]
        observations = tuple(Observation("p", np.zeros(3), np.eye(3), np.eye(3), spots) for spots in seen)
        vsm.request("calibrate", CalibrateRequest((CAMERA,), observations, apply=True))
        return rig.book[CAMERA].model.t_cam_base[0]

    yield arm, snap, calibrated
    vsm.close()


def test_the_mount_counts_where_it_was_at_the_exposures(held):
    _, snap, calibrated = held
    for x in (0.3, 0.3, 0.7):
        snap(x)
    assert calibrated(1000, 2000) == pytest.approx(0.3)


def test_the_mount_counts_though_the_arm_goes_on_before_the_images_are_there(held):
    arm, snap, calibrated = held

    def move_on():
        arm.x, arm.unknown = 0.7, {1000}

    arm.cameras.move_on = move_on
    snap(0.3)
    assert calibrated(1000) == pytest.approx(0.3)


def test_the_mount_is_known_of_images_whose_exposures_nobody_tells(held):
    arm, snap, calibrated = held
    arm.cameras.tells = False
    snap(0.3)
    assert calibrated(1000) == pytest.approx(0.3)


def test_a_mount_that_moved_between_the_exposures_is_refused(held):
    _, snap, calibrated = held
    for x in (0.3, 0.32):
        snap(x)
    with pytest.raises(StateError, match=r"left_wrist moved between the exposures, by 20\.0 mm and 0\.0 mrad"):
        calibrated(1000, 2000)


def test_a_mount_is_known_by_any_of_the_exposures_or_refused(held):
    arm, snap, calibrated = held
    arm.unknown = {1000}
    for _ in range(2):
        snap(0.3)
    assert calibrated(1000, 2000) == pytest.approx(0.3)
    with pytest.raises(StateError, match="the pose of left_wrist during the exposure of its cameras is not known"):
        calibrated(1000)


def test_a_testbed_whose_time_begins_again_and_the_oldest_exposures_are_forgotten():
    arm = Arm()
    mounts = Mounts(arm.now)
    mounts.note(WRIST, range(MOST_EXPOSURES + 1))
    with pytest.raises(StateError, match="exposure of its cameras is not known"):
        mounts.at(WRIST, [0])
    mounts.at(WRIST, [1])
    arm.unknown = {1}
    mounts.note(WRIST, [1])
    with pytest.raises(StateError, match="exposure of its cameras is not known"):
        mounts.at(WRIST, [1])
