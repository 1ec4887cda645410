"""``im vss run``: VSS alone on image topics, raw and compressed, with a light that a service switches."""

import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import rclpy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_srvs.srv import SetBool

from im_cell.fiducial import CELLS, code_of
from im_cell.rotations import matrix_of_quaternion, matrix_of_vector
from im_core.plugins import load
from im_core.processes.startup import patience_s
from im_core.ros import qos
from im_core.ros.calls import call_blocking
from im_core.ros.guard import GuardedNode
from im_core.ros.run import spin_in_thread
from im_msgs.srv import FiducialPose, Snap, SpotFind
from im_vss.catalogue import load_catalogue
from im_vss.ros.ports import Port
from im_vss.ros.vss_run import main

WIDTH, HEIGHT, SIDE_M, NUMBER = 320, 240, 0.08, 7
K = np.array([[300.0, 0.0, 158.0], [0.0, 300.0, 121.0], [0.0, 0.0, 1.0]])
TURN, PLACE = matrix_of_vector([np.pi - 0.3, 0.2, 0.0]), np.array([0.02, -0.01, 0.35])
SPOT, SIGMA_PX = np.array([251.3, 188.6]), 1.3
FINE = 4


def scene():
    """A fiducial of known pose in a grey room, as a sharp lens shows it [DN]."""
    cell, white = 24, np.pad(code_of(NUMBER), 1, constant_values=True)
    texture = np.where(np.kron(white, np.ones((cell, cell))), 190.0, 30.0)
    size = SIDE_M / CELLS / cell
    middle = (len(texture) - 1) / 2.0
    plate = np.array([[size, 0.0, -size * middle], [0.0, -size, size * middle], [0.0, 0.0, 1.0]])
    fine = np.array([[FINE, 0.0, (FINE - 1) / 2.0], [0.0, FINE, (FINE - 1) / 2.0], [0.0, 0.0, 1.0]])
    H = fine @ K @ np.column_stack((TURN[:, :2], PLACE)) @ plate
    seen = cv2.warpPerspective(texture, H, (FINE * WIDTH, FINE * HEIGHT), borderValue=100.0, flags=cv2.INTER_LINEAR)
    return cv2.GaussianBlur(seen.reshape(HEIGHT, FINE, WIDTH, FINE).mean(axis=(1, 3)), (0, 0), 0.6)


class Cameras(GuardedNode):
    """Drivers of two cameras, with raw colour and compressed images, and of a lamp."""

    def __init__(self):
        super().__init__("drivers")
        self.rng, self.still, self.lit = np.random.default_rng(1), scene(), False
        u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        self.spot = 120.0 * np.exp(-((u - SPOT[0]) ** 2 + (v - SPOT[1]) ** 2) / (2.0 * SIGMA_PX**2))
        self.raw = self.create_publisher(Image, "/left/image_raw", qos.SENSOR)
        self.packed = self.create_publisher(CompressedImage, "/right/image_raw/compressed", qos.SENSOR)
        self.infos = [
            self.create_publisher(CameraInfo, f"/{name}/camera_info", qos.SENSOR) for name in ("left", "right")
        ]
        self.create_service(SetBool, "/lamp", self._switch)
        self.create_timer(0.2, self._expose)

    def _switch(self, request, response):
        self.lit = response.success = request.data
        response.success = True
        return response

    def _expose(self):
        mean = self.still + self.spot * self.lit
        noise = np.sqrt((28.0**2 + 10.0 * mean) / 100.0)
        stamp = self.get_clock().now().to_msg()
        grey = np.clip(np.rint(mean + noise * self.rng.normal(size=mean.shape)), 0, 255).astype(np.uint8)
        image = Image(height=HEIGHT, width=WIDTH, encoding="bgr8", step=3 * WIDTH)
        image.data, image.header.stamp = np.dstack([grey] * 3).tobytes(), stamp
        self.raw.publish(image)
        packed = CompressedImage(format="mono8; png compressed ", data=cv2.imencode(".png", grey)[1].tobytes())
        packed.header.stamp = stamp
        self.packed.publish(packed)
        for publisher in self.infos:
            info = CameraInfo(width=WIDTH, height=HEIGHT, distortion_model="plumb_bob", d=[0.0] * 5, k=K.ravel())
            info.header.stamp = stamp
            publisher.publish(info)


def test_a_camera_that_sends_nothing_is_named(capfd, tmp_path, monkeypatch):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    monkeypatch.setattr("im_vss.ros.vss_run._FIRST_S", 0.5)
    assert main(["run", "--camera", "left:=/nowhere/image_raw"]) == 1
    assert "an image of left on /nowhere/image_raw (nobody publishes it)" in capfd.readouterr().err


@pytest.fixture(scope="module")
def ask(tmp_path_factory):
    """Asks a Service of VSS, which runs alone beside the drivers of the cameras."""
    folder = tmp_path_factory.mktemp("alone")
    rclpy.init()
    drivers, client = Cameras(), rclpy.create_node("client")
    spinners = [spin_in_thread(drivers), spin_in_thread(client)]
    with pytest.MonkeyPatch.context() as patch, open(folder / "log", "w") as log:
        patch.setenv("IM_RUN_DIR", str(folder))
        patch.setenv("IM_RESULTS_DIR", str(folder / "results"))
        command = [sys.executable, "-m", "im_vss.ros.vss_run", "run", "--light", "/lamp", "--fiducials", "7-8=80mm"]
        cameras = ["--camera", "left:=/left/image_raw", "right:=/right/image_raw/compressed"]
        vss = subprocess.Popen([*command, *cameras], stdout=log, stderr=log)

        def ask(kind, name, **fields):
            return call_blocking(client.create_client(kind, name), kind.Request(**fields), 2.0 * patience_s(), name)

        try:
            yield ask
        finally:
            vss.send_signal(signal.SIGINT)
            try:
                ended = vss.wait(60.0)
            finally:
                vss.kill()
                for spinner in spinners:
                    spinner.stop()
                rclpy.shutdown()
            assert ended == 0, Path(folder / "log").read_text()


def test_images_are_taken_of_both_kinds_of_topics(ask):
    answer = ask(Snap, "/vss/snap", cameras=["left", "right"])
    assert answer.success, answer.status.message


def test_a_fiducial_of_the_command_line_is_where_it_is(ask):
    answer = ask(FiducialPose, "/vss/fiducial_pose", cameras=["left", "right"], ids=[NUMBER])
    assert answer.success, answer.status.message
    assert [each.camera for each in answer.fiducials] == ["left", "right"], answer.cause
    for each in answer.fiducials:
        pose = each.pose.pose.pose
        place, turn = pose.position, pose.orientation
        off = np.array([place.x, place.y, place.z]) - PLACE
        covariance = np.array(each.pose.pose.covariance).reshape(6, 6)[:3, :3]
        assert off @ np.linalg.solve(covariance, off) < 30.0
        rotation = matrix_of_quaternion([turn.x, turn.y, turn.z, turn.w])
        assert np.trace(rotation.T @ TURN) > 3.0 - 0.01
    unseen = ask(FiducialPose, "/vss/fiducial_pose", cameras=["left"])
    assert "fiducial_8 in left not seen" in unseen.cause


def test_the_light_is_switched_for_its_spot(ask):
    answer = ask(SpotFind, "/vss/spot_find", cameras=["left", "right"])
    assert answer.success, answer.status.message
    for spot in answer.spots:
        assert spot.found, spot.cause
        off = np.array([spot.u, spot.v]) - SPOT
        assert off @ np.linalg.solve(np.array(spot.covariance).reshape(2, 2), off) < 25.0


def test_every_service_answers(ask):
    services = load_catalogue(None).services
    assert len(services) == 12
    for name, entry in services.items():
        answer = ask(load(entry.port, Port, "port").kind, f"/vss/{name}")
        assert answer.success or answer.status.message, name


@pytest.mark.parametrize("wrong", [["left=/a"], ["left:=a"], ["a:=/a", "a:=/b"], ["a:=/a", "--fiducials", "7"]])
def test_wrong_arguments_are_refused(wrong):
    with pytest.raises(SystemExit) as refused:
        main(["run", "--camera", *wrong])
    assert refused.value.code == 2
