"""``im calibrate --camera NAME:=TOPIC --seconds S``: a camera is calibrated from its driver's topic."""

import json
import signal
import subprocess
import sys

import numpy as np
import rclpy
from sensor_msgs.msg import Image

from bench.calibration.boards import Sensor, render
from bench.calibration.target_views import transform
from im_calibration.targets.target import target_of
from im_cell.camera_model import CameraModel
from im_core.processes.startup import patience_s
from im_core.ros import qos
from im_core.ros.guard import GuardedNode
from im_core.ros.run import spin_in_thread

TARGET = "chessboard:8x5:30mm"
D = np.array([-0.2, 0.05, 0.0, 0.0, 0.0])
CAMERA = CameraModel(320, 240, np.array([[300.0, 0.0, 162.0], [0.0, 301.0, 117.0], [0.0, 0.0, 1.0]]), D)
VIEWS = 8


def views():
    """Images of a board held at some places, two of each place."""
    target, rng = target_of(TARGET), np.random.default_rng(3)
    for k in range(VIEWS):
        pose = transform(rng.normal(0.0, 0.3, 3), np.zeros(3))
        pose[:3, 3] = [*rng.uniform(-0.04, 0.04, 2), rng.uniform(0.4, 0.55)] - pose[:3, :3] @ target.points.mean(axis=0)
        image = render(target, CAMERA, pose[:3, :3], pose[:3, 3], Sensor(), k)
        yield from (image, image)


def test_a_camera_is_calibrated_from_its_topic(tmp_path, wait_until):
    rclpy.init()
    driver = GuardedNode("driver")
    with spin_in_thread(driver):
        publisher = driver.create_publisher(Image, "/left/image_raw", qos.EVENTS)
        command = [
            sys.executable,
            "-m",
            "im_calibration.commands.calibrate_dataset",
            "--camera",
            "left:=/left/image_raw",
        ]
        options = ["--seconds", "3600", "--target", TARGET, "--results", str(tmp_path / "left")]
        with subprocess.Popen([*command, *options], stdout=subprocess.PIPE, text=True) as process:
            try:
                wait_until(publisher.get_subscription_count, "the recorder")
                for k, image in enumerate(views()):
                    message = Image(height=240, width=320, encoding="mono8", step=320, data=image.tobytes())
                    message.header.stamp.sec, message.header.stamp.nanosec = 1000 + k // 10, k % 10 * 100_000_000
                    publisher.publish(message)
                assert publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=patience_s()))
                process.send_signal(signal.SIGINT)
                told = process.communicate(timeout=10.0 * patience_s())[0]
            finally:
                process.kill()
        assert process.returncode == 0, told
    report = json.loads((tmp_path / "left" / "report.json").read_text())
    (camera,) = report["cameras"]
    assert np.abs(np.array(camera["K"]) - CAMERA.K).max() < 6.0 * camera["standard_deviations"]["fx"]
    assert f"{2 * VIEWS} images" in told
