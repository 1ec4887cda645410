"""Node ``/vss`` started with the calibrations of an earlier run, and what it says of itself on ``/diagnostics``."""

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

from im_cell.calibration_files import read_calibration
from im_cell.camera_model import CameraModel
from im_cell.robot import load_cell
from im_core.ros import qos
from im_msgs.srv import LaserPoint, Snap, SpotFindStereo
from im_sim.truth import draw_truth
from im_vss.camera_book import CameraBook
from im_vss.laser.book import LaserBook
from im_vss.managers import VisionClient
from im_vss.ros.messages import from_camera_info

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
    assert answer.status.message.endswith("does not say how well ceiling_left and ceiling_right are known")
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


def test_images_of_calibrated_cameras_are_rectified_for_who_wants_them(machine):
    """The same as from the camera info by OpenCV; a camera as drawn has none."""
    raw, info, rect = (
        machine.listen(kind, f"/ceiling_right/{topic}", qos.IMAGES)
        for kind, topic in ((Image, "image_raw"), (CameraInfo, "camera_info"), (Image, "image_rect"))
    )
    drawn = machine.listen(Image, "/wall/image_rect", qos.IMAGES)
    outputs = machine.vss._outputs
    machine.until(
        lambda: (
            all(each.get_subscription_count() for each in (outputs._raw["ceiling_right"], outputs._rect["wall"]))
            and outputs._rect["ceiling_right"].get_subscription_count()
        )
    )
    assert machine.call(Snap, "/vss/snap", cameras=["ceiling_right", "wall"]).success
    machine.until(lambda: raw and info and rect)
    assert rect[-1].header == raw[-1].header == info[-1].header
    pixels, shown = (np.frombuffer(each[-1].data, np.uint8).reshape(480, 640) for each in (raw, rect))
    K, D, R, P = (np.array(each) for each in (info[-1].k, info[-1].d, info[-1].r, info[-1].p))
    P = P.reshape(3, 4)[:, :3]
    maps = cv2.initUndistortRectifyMap(K.reshape(3, 3), D, R.reshape(3, 3), P, (640, 480), cv2.CV_32FC1)
    expected = cv2.remap(pixels, *maps, cv2.INTER_LINEAR)
    assert np.abs(shown.astype(int) - expected).max() <= 2
    assert not drawn


def assert_placed(transform, position, rotation):
    moved, turned = transform.transform.translation, transform.transform.rotation
    np.testing.assert_allclose([moved.x, moved.y, moved.z], position, atol=1e-12)
    q = [turned.x, turned.y, turned.z, turned.w]
    np.testing.assert_allclose(Rotation.from_quat(q).as_matrix(), rotation, atol=1e-12)


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


@pytest.fixture
def told(machine):
    """``told()``: the last message and values of ``/diagnostics`` by name of the status; empty before the first."""
    seen = machine.listen(DiagnosticArray, "/diagnostics", qos.STATUS)

    def last():
        for message in reversed(seen):
            statuses = {status.name: status for status in message.status}
            if "vss: modules" in statuses:
                return statuses, {pair.key: pair.value for status in message.status for pair in status.values}
        return {}, {}

    machine.until(lambda: last()[0])
    return last


def test_diagnostics_say_where_each_calibration_comes_from(earlier, told):
    statuses, values = told()
    status = statuses["vss: calibrations"]
    assert (status.level, status.hardware_id) == (DiagnosticStatus.OK, "cameras and laser scanner")
    assert status.message == "2 of 5 cameras are calibrated; the laser scanner is calibrated"
    assert values["ceiling_left"] == f"intrinsics {earlier[0]}/ceiling_left.yaml, pose {earlier[0]}/extrinsics.yaml"
    assert (values["wall"], values["laser_scanner"]) == ("as drawn", f"{earlier[0]}/laser.yaml")


def test_diagnostics_show_the_modules_and_warn_once_of_a_lease_that_lapsed(machine, told):
    vmm, somebody = machine.vss._vsm.managers["image_processing"], VisionClient("somebody")
    client = machine.client.create_client(Snap, "/vss/snap")
    machine.until(client.service_is_ready)
    with vmm.lend("vm_snap", somebody):
        future = client.call_async(Snap.Request(cameras=["wall"]))
        machine.until(lambda: (told()[1]["vm_snap owner"], told()[1]["vm_snap queue"]) == ("somebody", "1"))
        status = told()[0]["vss: modules"]
        assert (status.level, status.message) == (DiagnosticStatus.OK, "requests under way: 1")
        somebody.cancel()
    machine.until(future.done)
    machine.until(lambda: told()[0]["vss: modules"].level == DiagnosticStatus.WARN)
    assert "a lease lapsed of vm_snap" in told()[0]["vss: modules"].message
    machine.until(lambda: told()[0]["vss: modules"].level == DiagnosticStatus.OK)
    assert (told()[1]["vm_snap owner"], told()[1]["vm_snap lapsed"]) == ("free", "1")
