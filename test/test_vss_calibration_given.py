"""Node ``/vss`` started with the calibrations of an earlier run."""

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo
from tf2_msgs.msg import TFMessage

from im_core.calibration_files import read_calibration
from im_core.camera_model import CameraModel
from im_core.robot import load_cell
from im_core.ros import qos
from im_msgs.srv import LaserPoint, SpotFindStereo
from im_sim.truth import draw_truth
from im_vss.camera_book import CameraBook
from im_vss.laser.book import LaserBook
from im_vss.ros.messages import from_camera_info, quaternion

CELL = load_cell()
CEILING = ("ceiling_left", "ceiling_right")
SEED = 4
COVARIANCE = np.diag(np.full(10, 1e-8))


@pytest.fixture(scope="module")
def earlier(tmp_path_factory):
    """What a run left that found the true cameras and the true laser scanner; with the books of that run."""
    folder, truth = tmp_path_factory.mktemp("earlier"), draw_truth(CELL, SEED)
    cameras = CameraBook(CELL, CEILING, folder, [CEILING])
    models = {}
    for name in CEILING:
        true = truth.cameras[name]
        models[name] = CameraModel(640, 480, true.K, true.D, true.R_cam_base, true.t_cam_base_m)
    cameras.set_cameras(models)
    laser = LaserBook(CELL.laser, folder)
    laser.set(truth.laser.model(), COVARIANCE)
    return folder, cameras, laser


@pytest.fixture(scope="module")
def vss_parameters(earlier):
    return (f"calibration:={earlier[0]}",)


def test_the_first_point_is_there_at_once(machine):
    """Cameras as drawn give none."""
    infos = {name: machine.listen(CameraInfo, f"/{name}/camera_info", qos.SENSOR) for name in CEILING}
    machine.light(on=True)
    answer = machine.call(SpotFindStereo, "/vss/spot_find_stereo", cameras=CEILING)
    assert answer.found, answer.cause
    point = np.array([answer.point.point.x, answer.point.point.y, answer.point.point.z])
    assert np.linalg.norm(point - machine.light_at_home()) < 0.003
    machine.until(lambda: all(infos.values()))


def test_camera_infos_and_transforms_are_the_earlier_ones(machine, earlier):
    _, cameras, laser = earlier
    infos = {name: machine.listen(CameraInfo, f"/{name}/camera_info", qos.SENSOR) for name in CEILING}
    transforms = machine.listen(TFMessage, "/tf_static", qos.LATCHED)
    machine.call(SpotFindStereo, "/vss/spot_find_stereo", cameras=CEILING)
    machine.until(lambda: transforms and all(infos.values()))
    placed = {transform.child_frame_id: transform for transform in transforms[-1].transforms}
    for name in CEILING:
        entry, info = cameras[name], infos[name][-1]
        seen = from_camera_info(info)
        assert np.array_equal(seen.K, entry.model.K)
        assert np.array_equal(seen.D, entry.model.D)
        np.testing.assert_allclose(np.reshape(info.p, (3, 4)), entry.rectified.P, atol=1e-9)
        np.testing.assert_allclose(np.reshape(info.r, (3, 3)), entry.rectified.R, atol=1e-12)
        assert_placed(placed[entry.frame], entry.model.position, entry.model.R_cam_base.T)
    assert infos["ceiling_right"][-1].p[3] < -100.0
    assert_placed(placed["laser_scanner"], laser.entry.model.position, laser.entry.model.rotation)


def assert_placed(transform, position, rotation):
    moved, turned = transform.transform.translation, transform.transform.rotation
    np.testing.assert_allclose([moved.x, moved.y, moved.z], position, atol=1e-12)
    q = [turned.x, turned.y, turned.z, turned.w]
    assert abs(np.dot(q, quaternion(rotation))) == pytest.approx(1.0, abs=1e-12)


def test_the_laser_is_used_as_calibrated(machine):
    answer = machine.call(LaserPoint, "/vss/laser_point", mirror1=0.0, mirror2=0.0, on=False)
    assert answer.success, answer.status.message
    assert answer.calibrated


def test_this_run_leaves_all_that_it_started_with(machine, earlier):
    (kept,) = {machine.vss._book._directory, machine.vss._laser.book._directory}
    assert kept != earlier[0]
    found, before = read_calibration(kept, CELL), read_calibration(earlier[0], CELL)
    assert found.summary() == before.summary()
    assert np.array_equal(found.laser.covariance, COVARIANCE)
