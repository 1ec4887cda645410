"""Node ``/vss`` with the testbed, as ROS users meet it."""

import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from sensor_msgs.srv import SetCameraInfo
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from im_cell.calibration_files import read_calibration
from im_cell.camera_model import CameraModel
from im_cell.robot import load_cell
from im_core.errors import DataError
from im_core.ros import qos
from im_msgs.msg import Observation, Spot
from im_msgs.srv import Calibrate, Snap, SpotFind, SpotFindStereo, VisionCancel
from im_sim.cameras.bank import STEPS
from im_vss.ros.messages import to_camera_info
from support.flood import Flood

CEILING = ["ceiling_left", "ceiling_right"]


def test_spots_are_where_the_light_is(machine):
    machine.light(on=True)
    answer = machine.call(SpotFind, "/vss/spot_find", cameras=CEILING)
    assert answer.success, answer.status.message
    truth = json.loads((machine.folder / "truth.json").read_text())
    assert [spot.camera for spot in answer.spots] == CEILING
    light = machine.light_at_home()
    for spot in answer.spots:
        assert spot.found, spot.cause
        true = truth["cameras"][spot.camera]
        camera = CameraModel(640, 480, true["K"], true["D"], true["R_cam_base"], true["t_cam_base_m"])
        covariance = np.array(spot.covariance).reshape(2, 2)
        error = camera.project(light) - (spot.u, spot.v)
        assert error @ np.linalg.solve(covariance, error) < 25.0
        assert 0.01 < np.sqrt(covariance[0, 0]) < 0.06
    assert answer.spots[0].stamp == answer.spots[1].stamp
    timing = json.loads(answer.timing_json)
    steps = {"expose_s", *STEPS, "handover_s", "snap_s", "display_s", "find_s", "total_s"}
    assert steps == set(timing)
    assert 0.0 < max(timing.values()) == timing["total_s"]


def test_light_off_is_not_found_with_its_cause(machine):
    machine.light(on=False)
    answer = machine.call(SpotFind, "/vss/spot_find", cameras=CEILING)
    assert answer.success
    assert [(spot.found, spot.cause) for spot in answer.spots] == [
        (False, "no light seen: left_led and right_led are off, /testbed/set_light switches them on")
    ] * 2


def test_stereo_without_a_light_says_so_for_each_camera(machine):
    machine.light(on=False)
    answer = machine.call(SpotFindStereo, "/vss/spot_find_stereo", cameras=CEILING)
    assert (answer.success, answer.found) == (True, False)
    assert answer.cause.count("no light seen") == 2


class Reflecting:
    """Wraps the cameras: beside the light at a place [px] there is its reflection, by a share as bright, 40 px away."""

    def __init__(self, take, place, share):
        self.take_frames, self.share, (self.u, self.v) = take, share, np.round(place).astype(int)

    def __call__(self, order, exposed):
        taken = self.take_frames(order, exposed)
        return replace(taken, frames={name: self._with(*pair) for name, pair in taken.frames.items()})

    def _with(self, off, on):
        image, rows = on.image.copy(), slice(self.v - 8, self.v + 9)
        here, there = slice(self.u - 8, self.u + 9), slice(self.u + 32, self.u + 49)
        light = self.share * (on.image[rows, here].astype(float) - off.image[rows, here])
        image[rows, there] = np.clip(image[rows, there] + light, 0, 255).round().astype(np.uint8)
        return off, replace(on, image=image)


def test_reflections_are_handed_on_as_candidates(machine, monkeypatch):
    """Where two are about as bright the search cannot say which is the light; whoever asked may know."""
    machine.light(on=True)

    def find():
        answer = machine.call(SpotFind, "/vss/spot_find", cameras=["ceiling_left"])
        (seen,) = answer.candidates
        assert (seen.camera, seen.stamp) == ("ceiling_left", answer.spots[0].stamp)
        return answer.spots[0], seen.candidates

    light, (only,) = find()
    assert (only.u, only.v, only.found) == (light.u, light.v, True)
    take = machine.vss._rig.source.take_frames
    for share, found in ((0.9, False), (0.25, True)):
        monkeypatch.setattr(machine.vss._rig.source, "take_frames", Reflecting(take, (light.u, light.v), share))
        spot, candidates = find()
        assert (spot.found, "several candidates: (" in spot.cause) == (found, not found)
        assert np.allclose(
            [(each.u, each.v) for each in candidates], [(light.u + x, light.v) for x in (0, 40)], atol=0.5
        )
        assert all(each.found and np.linalg.det(np.reshape(each.covariance, (2, 2))) > 0.0 for each in candidates)
    monkeypatch.undo()
    machine.light(on=False)
    assert find()[1] == []


def test_images_infos_and_marker(machine):
    machine.light(on=True)
    raw = machine.listen(Image, "/ceiling_left/image_raw", qos.IMAGES)
    info = machine.listen(CameraInfo, "/ceiling_left/camera_info", qos.IMAGES)
    spots = machine.listen(PointStamped, "/ceiling_left/spot", qos.EVENTS)
    shown = machine.listen(Image, "/ceiling_left/image_display", qos.IMAGES)
    answer = machine.call(SpotFind, "/vss/spot_find", cameras=["ceiling_left"])
    machine.until(lambda: len(raw) == 2 and len(info) == 2 and len(shown) == 1 and len(spots) == 1)
    assert [image.header for image in raw] == [camera.header for camera in info]
    assert raw[1].header.frame_id == "ceiling_left_optical_frame"
    assert raw[1].header.stamp == shown[0].header.stamp == answer.spots[0].stamp
    assert (raw[1].encoding, shown[0].encoding) == ("mono8", "rgb8")
    colours = np.frombuffer(shown[0].data, np.uint8).reshape(480, 640, 3).astype(int)
    rows, columns = np.nonzero(colours[..., 1] > colours[..., 0] + 100)
    near = np.hypot(columns - answer.spots[0].u, rows - answer.spots[0].v) < 20.0
    assert near.sum() > 20


def test_snap(machine):
    answer = machine.call(Snap, "/vss/snap", cameras=["wall", "wrist_left", "table"])
    assert answer.success, answer.status.message
    assert [image.header.frame_id.removesuffix("_optical_frame") for image in answer.images] == [
        "wall", "wrist_left", "table",
    ]  # fmt: skip
    assert [image.header for image in answer.images] == [info.header for info in answer.camera_infos]
    assert all(len(image.data) == 640 * 480 and np.std(image.data) > 3.0 for image in answer.images)


def test_an_exposure_that_is_no_whole_ticks_is_told_as_it_was_made(machine):
    made = machine.call(Snap, "/vss/snap", cameras=["wall"], exposure=0.0045)
    assert (made.success, made.status.message) == (True, "")
    rounded = machine.call(Snap, "/vss/snap", cameras=["wall"], exposure=0.006)
    assert (rounded.success, rounded.status.message) == (True, "exposed for 0.0045 s, not for 0.006 s")
    np.testing.assert_allclose(np.mean(rounded.images[0].data), np.mean(made.images[0].data), atol=0.5)


ABSURD = [
    ([fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], sentence)
    for fx, fy, cx, cy, sentence in (
        (0.0, 600.0, 320.0, 240.0, "fx is 0 px, it must be within 32 and 64000, 0.05 to 100 image widths"),
        (-600.0, 600.0, 320.0, 240.0, "fx is -600 px, it must be within 32 and 64000"),
        (600.0, float("nan"), 320.0, 240.0, "fy is nan px, it must be within 32 and 64000"),
        (600.0, 1e9, 320.0, 240.0, "fy is 1e+09 px, it must be within 32 and 64000"),
        (600.0, 600.0, 1700.0, 240.0, "cx is 1700 px, it must be within -320 and 960, at most 0.5 image widths"),
        (600.0, 600.0, 320.0, -300.0, "cy is -300 px, it must be within -240 and 720, at most 0.5 image heights"),
    )
]


def test_camera_infos_are_set_checked_and_kept(machine):
    """Latched, and zero as the convention is for a camera of which nothing is known."""
    latched = machine.listen(CameraInfo, "/table/camera_info", qos.LATCHED)
    machine.until(lambda: latched)
    for info in (latched[0], machine.call(Snap, "/vss/snap", cameras=["table"]).camera_infos[0]):
        assert (info.width, info.height, info.header.frame_id) == (640, 480, "table_optical_frame")
        assert not any([*info.k, *info.r, *info.p, *info.d])
    info.k, info.d = [611.5, 0.0, 320.0, 0.0, 612.5, 240.0, 0.0, 0.0, 1.0], [-0.2, 0.03, 1e-4, 0.0, 0.0]
    answer = machine.call(SetCameraInfo, "/table/set_camera_info", camera_info=info)
    assert answer.success, answer.status_message
    machine.until(lambda: latched[-1].k[0] == 611.5)
    later = machine.listen(CameraInfo, "/table/camera_info", qos.LATCHED)
    machine.until(lambda: later)
    assert [told.k[0] for told in later] == [611.5]
    assert machine.call(Snap, "/vss/snap", cameras=["table"]).camera_infos[0].k[0] == 611.5
    folder = Path(answer.status_message.removeprefix("table has new intrinsics; written to "))
    stored = yaml.safe_load((folder / "table.yaml").read_text())
    assert (stored["camera_name"], stored["distortion_model"]) == ("table", "plumb_bob")
    assert stored["camera_matrix"]["data"][0] == 611.5
    assert stored["projection_matrix"]["rows"] == 3
    for change, sentence in (
        ({"width": 1280}, "table takes images of 640 x 480 px, the calibration is for 1280 x 480 px"),
        ({"d": [float("nan")] * 5}, "not finite"),
        ({"d": [1e300, 0.0, 0.0, 0.0, 0.0]}, "D = [1e+300, 0.0, 0.0, 0.0, 0.0] folds the image in its middle half"),
        ({"d": [0.0] * 8}, "4 or 5 coefficients"),
        *(({"k": K}, sentence) for K, sentence in ABSURD),
        ({"distortion_model": "omnidirectional"}, "lens model 'omnidirectional' is unknown"),
        ({"distortion_model": "equidistant"}, "equidistant has 4 coefficients, got 5"),
    ):
        wrong = machine.call(Snap, "/vss/snap", cameras=["table"]).camera_infos[0]
        for field, value in change.items():
            setattr(wrong, field, value)
        answer = machine.call(SetCameraInfo, "/table/set_camera_info", camera_info=wrong)
        assert not answer.success
        assert sentence in answer.status_message
    assert machine.call(Snap, "/vss/snap", cameras=["table"]).camera_infos[0].k[0] == 611.5


def observations_of(truth, poses):
    """What a perfect robot and cameras with 0.03 px of noise would report."""
    rng = np.random.default_rng(7)
    result = []
    for number in range(poses):
        position = rng.uniform([-0.8, -0.4, 0.7], [0.8, 0.4, 1.5])
        rotation = Rotation.random(random_state=rng)
        light = position + rotation.apply(truth["leds"]["left_led"]["offset_m"])
        message = Observation(pose=f"p{number}", position_covariance=(np.eye(3) * 1e-8).ravel())
        target = message.wrist
        target.position.x, target.position.y, target.position.z = position
        q = target.orientation
        q.x, q.y, q.z, q.w = rotation.as_quat()
        for name in CEILING:
            true = truth["cameras"][name]
            camera = CameraModel(640, 480, true["K"], true["D"], true["R_cam_base"], true["t_cam_base_m"])
            u, v = camera.project(light) + rng.normal(0.0, 0.03, 2)
            covariance = (np.eye(2) * 0.03**2).ravel()
            found = bool(camera.contains([u, v]))
            message.spots.append(Spot(camera=name, found=found, u=u, v=v, covariance=covariance))
        result.append(message)
    return result


def test_calibrate_applies_and_writes(machine, tmp_path):
    truth = json.loads((machine.folder / "truth.json").read_text())
    transforms = machine.listen(TFMessage, "/tf_static", qos.LATCHED)
    answer = machine.call(
        Calibrate, "/vss/calibrate", cameras=CEILING, observations=observations_of(truth, 40),
        directory=str(tmp_path / "result"), apply=True,
    )  # fmt: skip
    assert answer.success, answer.status.message
    report = answer.report
    assert report.success, report.message
    assert np.allclose(report.led_offset, truth["leds"]["left_led"]["offset_m"], atol=1e-3)
    assert json.loads(report.json)["success"]
    assert {"report.json", "ceiling_left.yaml", "extrinsics.yaml"} <= set(os.listdir(tmp_path / "result"))
    info = machine.call(Snap, "/vss/snap", cameras=["ceiling_left"]).camera_infos[0]
    assert np.array_equal(info.k, report.cameras[0].k)
    assert abs(info.k[0] - truth["cameras"]["ceiling_left"]["K"][0][0]) < 3.0
    right = yaml.safe_load((tmp_path / "result" / "ceiling_right.yaml").read_text())["projection_matrix"]["data"]
    assert np.isclose(right[3] / right[0], -1.8, atol=0.05)  # the file is of the stereo pair: minus the baseline

    def placed():
        if not transforms:
            return False
        found = {t.child_frame_id: t for t in transforms[-1].transforms}["ceiling_right_optical_frame"]
        true = truth["cameras"]["ceiling_right"]
        position = -np.array(true["R_cam_base"]).T @ true["t_cam_base_m"]
        seen = found.transform.translation
        return found.header.frame_id == "world" and np.allclose([seen.x, seen.y, seen.z], position, atol=0.02)

    machine.until(placed)
    machine.light(on=True)
    seen = machine.call(SpotFindStereo, "/vss/spot_find_stereo", cameras=CEILING)
    assert (seen.found, seen.status.message) == (True, ""), seen.cause
    place, covariance = seen.point.point, np.reshape(seen.covariance, (3, 3))
    error = machine.light_at_home() - (place.x, place.y, place.z)
    assert error @ np.linalg.solve(covariance, error) < 30.0
    kept = read_calibration(machine.vss._book._directory, machine.vss._rig.cell)
    assert kept.covariance.cameras == tuple(CEILING)
    written = read_calibration(tmp_path / "result", machine.vss._rig.cell).covariance
    assert np.array_equal(written.matrix, kept.covariance.matrix)
    answer = machine.call(
        Calibrate,
        "/vss/calibrate",
        cameras=CEILING,
        observations=observations_of(truth, 4),
        directory=str(tmp_path / "too_few"),
        apply=True,
    )
    assert not answer.success
    assert "in 4 poses, at least 7 are needed" in answer.status.message
    assert os.listdir(tmp_path / "too_few") == ["observations.json"]
    observations = observations_of(truth, 20)
    for observation in observations[3:]:
        observation.spots = [spot for spot in observation.spots if spot.camera == "ceiling_left"]
    answer = machine.call(Calibrate, "/vss/calibrate", cameras=CEILING, observations=observations, apply=True)
    assert (answer.success, answer.report.success) == (True, False)
    assert [camera.name for camera in answer.report.cameras] == ["ceiling_left"]
    assert "Left out: Camera ceiling_right saw the LED in 3 poses" in answer.report.message
    infos = machine.call(Snap, "/vss/snap", cameras=CEILING).camera_infos
    assert np.array_equal(infos[0].k, answer.report.cameras[0].k)
    assert np.array_equal(infos[1].k, report.cameras[1].k)
    answer = machine.call(Calibrate, "/vss/calibrate", cameras=["wrist_left"], observations=observations_of(truth, 9))
    assert "wrist_left saw the LED in 0 poses, at least 7 are needed" in answer.status.message


def test_a_dead_camera_process_is_named_and_replaced(machine):
    os.kill(machine.vss._source._child.pid, signal.SIGKILL)
    first = machine.call(Snap, "/vss/snap", cameras=["wall"])
    assert first.success or "the camera process is missing" in first.status.message
    second = machine.call(Snap, "/vss/snap", cameras=["wall"])
    assert second.success, second.status.message


def test_images_are_there_as_jpeg_for_who_wants_them(machine):
    """The same image, of the same moment, in the format that image_transport names."""
    raw = machine.listen(Image, "/wall/image_raw", qos.IMAGES)
    small = machine.listen(CompressedImage, "/wall/image_raw/compressed", qos.IMAGES)
    outputs = machine.vss._outputs
    machine.until(lambda: all(p["wall"].get_subscription_count() for p in (outputs._raw, outputs._compressed)))
    assert machine.call(Snap, "/vss/snap", cameras=["wall"]).success
    machine.until(lambda: raw and small)
    (taken,), (told,) = raw, small
    assert told.header == taken.header
    assert (told.format, bytes(told.data[:3])) == ("mono8; jpeg compressed ", b"\xff\xd8\xff")
    assert len(told.data) < len(taken.data) / 2
    pixels = np.frombuffer(taken.data, np.uint8).reshape(taken.height, taken.width)
    decoded = cv2.imdecode(np.frombuffer(told.data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert decoded.shape == pixels.shape
    assert np.abs(decoded.astype(float) - pixels).mean() < 3.0


def test_markers_show_what_cameras_see_and_which_lights_are_on(machine):
    machine.light(on=False)
    told = machine.listen(MarkerArray, "/markers", qos.LATCHED)

    def newest(namespace):
        machine.until(lambda: told)
        return {m.header.frame_id: m for m in told[-1].markers if m.ns == namespace}

    views = newest("cameras")
    entries = list(machine.vss._book.entries())
    assert list(views) == [entry.frame for entry in entries]
    for entry in entries:
        lens = entry.model
        ends = np.array([[p.x, p.y, p.z] for p in views[entry.frame].points]).reshape(4, 4, 3)
        assert (ends[:, 0] == 0.0).all()  # each edge begins in the camera
        assert (ends[:, 2] == ends[:, 1]).all()
        seen = CameraModel(lens.width, lens.height, lens.K, lens.D).project(ends[:, 1])
        right, low = lens.width - 0.5, lens.height - 0.5
        np.testing.assert_allclose(seen, [[-0.5, -0.5], [right, -0.5], [right, low], [-0.5, low]], atol=1e-6)
    (box,) = newest("workspace").values()
    assert (box.header.frame_id, box.scale.x, box.pose.position.z) == ("world", 2.0, 1.1)
    dark = newest("lights")["left_led"].color
    machine.light(on=True)
    machine.until(lambda: newest("lights")["left_led"].color != dark)
    assert newest("lights")["right_led"].color == dark


def test_a_lens_that_folds_the_corners_of_its_image_takes_nothing_from_the_other_cameras(machine):
    """Its own view is drawn as far as the lens can be inverted."""
    told = machine.listen(MarkerArray, "/markers", qos.LATCHED)
    health = machine.listen(DiagnosticArray, "/diagnostics", qos.STATUS)
    book = machine.vss._book
    before = book["table"].model
    poor = replace(before, D=np.array([-0.6, 0.0, 0.0, 0.0, 0.0]))
    with pytest.raises(DataError, match="cannot be inverted"):
        poor.undistort(poor.corners())
    machine.until(lambda: told)
    count = len(told)
    try:
        info = to_camera_info(replace(book["table"], model=poor, intrinsics_file=Path()), 0)
        assert machine.call(SetCameraInfo, "/table/set_camera_info", camera_info=info).success
        machine.until(lambda: len(told) > count)
        views = {m.header.frame_id: m for m in told[-1].markers if m.ns == "cameras"}
        assert list(views) == [entry.frame for entry in book.entries()]
        assert {m.ns for m in told[-1].markers} >= {"lights", "objects", "workspace"}
        far = np.array([[p.x, p.y, p.z] for p in views["table_optical_frame"].points]).reshape(4, 4, 3)[:, 1]
        seen = poor.through_lens(far[:, :2] / far[:, 2:])
        np.testing.assert_allclose(seen, poor.corners(poor.invertible_share), atol=1e-6)
        sentence = f"in the middle {100 * poor.invertible_share:.0f} % of the image's sides only"
        machine.until(lambda: any(sentence in value for value in table_in(health)))
    finally:
        book.set_cameras({"table": before}, pose=False)


def table_in(health):
    return [pair.value for message in health for each in message.status for pair in each.values if pair.key == "table"]


def test_markers_show_the_targets_and_hundred_times_what_a_calibration_leaves(machine):
    told = machine.listen(MarkerArray, "/markers", qos.LATCHED)
    spots = np.array([[100.0, 200.0], [np.nan, np.nan], [320.0, 240.0]])
    residuals = np.array([[0.02, -0.01], [np.nan, np.nan], [0.0, 0.03]])
    machine.vss._book.residuals["wall"] = spots, residuals

    entry = machine.vss._book["wall"]

    def newest(namespace, frame):
        found = told[-1].markers if told else []
        return [m for m in found if (m.ns, m.header.frame_id) == (namespace, frame)]

    machine.until(lambda: newest("residuals", entry.frame))
    (lines,) = newest("residuals", entry.frame)
    points = np.array([[p.x, p.y, p.z] for p in lines.points]).reshape(2, 2, 3)  # a spot that was not seen has none
    ends = points[..., :2] / points[..., 2:] @ entry.model.K[:2, :2].T + entry.model.K[:2, 2]
    np.testing.assert_allclose(ends[:, 0], (spots - residuals)[[0, 2]], atol=1e-9)
    np.testing.assert_allclose(ends[:, 1] - ends[:, 0], 100.0 * residuals[[0, 2]], atol=1e-9)
    assert lines.text == "0.026 px rms of 2 spots"  # sqrt((0.02^2 + 0.01^2 + 0.03^2) / 2)
    plates = [(m.pose.position.x, m.pose.position.y, m.pose.position.z, m.scale.x) for m in newest("objects", "world")]
    assert plates == [(*target.position, target.plate) for target in load_cell().targets]


def test_a_cancellation_is_taken_before_ten_thousand_messages(machine, wait_until):
    flood, cancel = Flood(machine.vss, machine.client), machine.client.create_client(VisionCancel, "/vss/cancel")
    assert cancel.wait_for_service(60.0)
    flood.fill(wait_until)
    answer = cancel.call_async(VisionCancel.Request(request="spot_find #0"))
    answer.add_done_callback(flood.stopped)
    flood.let_go(wait_until)
    flood.end()
    assert "spot_find #0" in answer.result().status.message
