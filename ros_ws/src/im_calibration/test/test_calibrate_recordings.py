"""``im calibrate --bag``, and of videos: rests of a robot are found, cameras are as drawn, bad recordings are told."""

import json

import cv2
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from bench.calibration.boards import Sensor, render
from bench.calibration.target_views import transform
from im_calibration.commands.calibrate_dataset import main
from im_calibration.targets.target import target_of
from im_cell.camera_model import CameraModel

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
TARGET = "chessboard:8x5:30mm"
D = np.array([-0.2, 0.05, 0.0, 0.0, 0.0])
LEFT = CameraModel(320, 240, np.array([[300.0, 0.0, 162.0], [0.0, 301.0, 117.0], [0.0, 0.0, 1.0]]), D)
LINK_CAMERA = transform(np.array([0.2, -0.3, 0.1]), np.array([0.02, 0.05, 0.1]))
BASE_TARGET = transform(np.array([0.1, 0.1, 1.0]), np.array([0.4, 0.1, 0.0]))
BEGIN, MS = 1_700_000_000_000_000_000, 1_000_000
RESTS, REST_MS, MOVE_MS = 8, 1000, 1000
JOINTS = "".join(
    f'<link name="l{i + 1}"/><joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/>'
    f'<axis xyz="{axis}"/></joint>'
    for i, (kind, axis) in enumerate(
        [("prismatic", "1 0 0"), ("prismatic", "0 1 0"), ("prismatic", "0 0 1"),
         ("revolute", "0 0 1"), ("revolute", "0 1 0"), ("revolute", "1 0 0")]
    )
)  # fmt: skip
URDF = f'<robot name="gantry"><link name="l0"/>{JOINTS}</robot>'


def header(stamp_ns, frame="base"):
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def image_message(pixels, encoding, stamp_ns=BEGIN, big=False):
    """A raw image; rows end with two bytes more than the pixels need."""
    data = pixels.astype(pixels.dtype.newbyteorder(">" if big else "<"))
    rows = np.pad(np.ascontiguousarray(data).view(np.uint8).reshape(len(pixels), -1), ((0, 0), (0, 2)))
    return TYPES["sensor_msgs/msg/Image"](
        header(stamp_ns), *pixels.shape[:2], encoding, int(big), rows.shape[1], rows.ravel()
    )


def compressed(pixels, kind, stamp_ns=BEGIN, ending=".png"):
    data = cv2.imencode(ending, pixels)[1].ravel()
    return TYPES["sensor_msgs/msg/CompressedImage"](header(stamp_ns), kind, data)


def tf(stamp_ns, parent, child, pose):
    turn = Rotation.from_matrix(pose[:3, :3]).as_quat()
    content = TYPES["geometry_msgs/msg/Transform"](
        TYPES["geometry_msgs/msg/Vector3"](*pose[:3, 3]), TYPES["geometry_msgs/msg/Quaternion"](*turn)
    )
    return TYPES["tf2_msgs/msg/TFMessage"](
        [TYPES["geometry_msgs/msg/TransformStamped"](header(stamp_ns, parent), child, content)]
    )


def write(path, messages, plugin=StoragePlugin.MCAP):
    """A bag of ``(when, topic, message)``."""
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for when, topic, message in sorted(messages, key=lambda each: each[:2]):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], when, STORE.serialize_cdr(message, kind))
    return path


@pytest.fixture(scope="module")
def run_of_robot():
    """Poses of the link at each 20 ms, and what the camera on it saw at each 250 ms, also while it moved."""
    rng, target = np.random.default_rng(3), target_of(TARGET)
    rests = []
    for _ in range(RESTS):
        pose = transform(rng.normal(0.0, 0.3, 3), np.zeros(3))
        pose[:3, 3] = [*rng.uniform(-0.04, 0.04, 2), rng.uniform(0.4, 0.55)] - pose[:3, :3] @ target.points.mean(axis=0)
        rests.append(BASE_TARGET @ np.linalg.inv(LINK_CAMERA @ pose))
    links, images = {}, {}
    for ms in range(0, RESTS * (REST_MS + MOVE_MS) - MOVE_MS, 10):
        k, within = divmod(ms, REST_MS + MOVE_MS)
        share = max(0.0, (within - REST_MS) / MOVE_MS)
        link = rests[k].copy()
        if share:
            step = Rotation.from_matrix(rests[k][:3, :3].T @ rests[k + 1][:3, :3]).as_rotvec()
            link[:3, 3] += share * (rests[k + 1][:3, 3] - rests[k][:3, 3])
            link[:3, :3] = link[:3, :3] @ Rotation.from_rotvec(share * step).as_matrix()
        if ms % 20 == 0:
            links[BEGIN + ms * MS] = link
        if ms % 250 == 130:
            view = np.linalg.inv(LINK_CAMERA) @ np.linalg.inv(link) @ BASE_TARGET
            images[BEGIN + ms * MS] = render(target, LEFT, view[:3, :3], view[:3, 3], Sensor(), ms)
    return links, images


def calibrate(results, *more, target=TARGET):
    return main(["--target", target, "--results", str(results), *map(str, more)])


def reported(folder):
    report = json.loads((folder / "report.json").read_text())
    assert report["success"], report["message"]
    return report


def check_camera(report):
    (camera,) = report["cameras"]
    off = np.array(camera["t_cam_base_m"]) - np.linalg.inv(LINK_CAMERA)[:3, 3]
    sd = np.array([camera["standard_deviations"][name] for name in ("tx", "ty", "tz")])
    assert np.all(np.abs(off) < 6.0 * sd)
    assert np.abs(np.array(camera["K"]) - LEFT.K).max() < 6.0 * camera["standard_deviations"]["fx"]
    assert camera["standard_deviations"]["fx"] < 2.0


@pytest.mark.parametrize("kind", ["transforms", "joints", "file"])
def test_a_camera_on_a_robot(run_of_robot, tmp_path, capsys, kind):
    links, images = run_of_robot
    messages = [
        (t, "/left/image_raw", image_message(np.dstack([image] * 3), "bgr8", t)) if kind == "transforms" else
        (t, "/left/image_raw/compressed", compressed(image, "mono8; png compressed ", t)) for t, image in images.items()
    ]  # fmt: skip
    topic = messages[0][1]
    if kind == "transforms":
        mount = transform(np.array([0.3, 0.2, -0.4]), np.array([0.1, 0.0, 0.2]))
        for t, link in links.items():
            messages.append((t, "/tf", tf(t, "world", "flange", mount @ link @ mount)))
        messages += [(BEGIN, "/tf_static", tf(BEGIN, "flange", "tool0", np.linalg.inv(mount)))]
        messages += [(BEGIN + 1, "/tf_static", tf(BEGIN, "world", "base_link", mount))]
        options = ["--base", "base_link", "--tool", "tool0"]
    elif kind == "joints":
        for t, link in links.items():
            q = [*link[:3, 3], *Rotation.from_matrix(link[:3, :3]).as_euler("ZYX")]
            state = TYPES["sensor_msgs/msg/JointState"](
                header(t), [f"j{i}" for i in range(6)], np.array(q), np.zeros(0), np.zeros(0)
            )
            messages.append((t, "/joint_states", state))
        (tmp_path / "gantry.urdf").write_text(URDF)
        options = ["--urdf", tmp_path / "gantry.urdf", "--base", "l0", "--tool", "l6"]
    else:
        rows = (
            f"{t // 10**9}.{t % 10**9:09d} " + " ".join(
                f"{x:.9f}" for x in (*link[:3, 3], *Rotation.from_matrix(link[:3, :3]).as_quat())
            )
            for t, link in links.items()
        )  # fmt: skip
        (tmp_path / "trajectory.txt").write_text("# stamp x y z qx qy qz qw\n" + "\n".join(rows) + "\n")
        options = ["--robot", tmp_path / "trajectory.txt"]
    bag = write(tmp_path / "bag", messages, StoragePlugin.SQLITE3 if kind == "joints" else StoragePlugin.MCAP)
    camera = ["--bag", bag, "--camera", f"left:={topic}", "--eye-in-hand"]
    assert calibrate(tmp_path / "results", *camera, *options) == 0
    check_camera(reported(tmp_path / "results"))
    told = capsys.readouterr().out
    assert f"{RESTS} rests, the target is seen in {RESTS}" in told
    assert "while it moves" in told
    observed = json.loads((tmp_path / "results" / "observations.json").read_text())
    assert len(observed["target"]["views"]) == RESTS
