"""``im calibrate --bag``, and of videos: rests of a robot are found, cameras are as drawn, bad recordings are told."""

import contextlib
import io
import json
import re
import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from bench.calibration.boards import Sensor, render
from bench.calibration.target_views import transform
from im_calibration.commands.calibrate_dataset import main
from im_calibration.recorded.image_message import grey_image
from im_calibration.recorded.recordings import ImageRecording
from im_calibration.recorded.transforms import tree_of_joints
from im_calibration.targets.recorded_views import views_in_motion
from im_calibration.targets.target import target_of
from im_cell.camera_model import CameraModel
from im_core.errors import DataError

pytestmark = pytest.mark.usefixtures("without_pictures")

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
URDF = f'<robot name="gantry"><link name="base_link"/>{JOINTS}</robot>'.replace("l0", "base_link").replace(
    "l6", "tool0"
)


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


def write(path, messages):
    """A bag of ``(when, topic, message)``."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for when, topic, message in sorted(messages, key=lambda each: each[:2]):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], when, STORE.serialize_cdr(message, kind))
    return path


@pytest.fixture(scope="module")
def run_of_robot():
    """Poses of the link at each 20 ms, and what the camera on it saw at each 500 ms, also while it moved."""
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
        if ms % 500 == 250:
            view = np.linalg.inv(LINK_CAMERA) @ np.linalg.inv(link) @ BASE_TARGET
            images[BEGIN + ms * MS] = render(target, LEFT, view[:3, :3], view[:3, 3], Sensor(), ms)
    return links, images


@pytest.fixture(scope="module")
def guide(run_of_robot, tmp_path_factory):
    """The folder of results after the commands of the guide for bags, all of which end well, and what they print."""
    folder, (links, images) = tmp_path_factory.mktemp("guide"), run_of_robot
    mount = transform(np.array([0.3, 0.2, -0.4]), np.array([0.1, 0.0, 0.2]))
    messages = [
        (BEGIN, "/tf_static", tf(BEGIN, "flange", "tool0", np.linalg.inv(mount))),
        (BEGIN + 1, "/tf_static", tf(BEGIN, "world", "base_link", mount)),
    ]
    rows = ["# stamp x y z qx qy qz qw"]
    for t, image in images.items():
        messages.append((t, "/left/image_raw", image_message(np.dstack([image] * 3), "bgr8", t)))
        messages.append((t, "/left/image_raw/compressed", compressed(image, "mono8; png compressed ", t)))
    for t, link in links.items():
        turn = Rotation.from_matrix(link[:3, :3])
        q = np.array([*link[:3, 3], *turn.as_euler("ZYX")])
        names = [f"j{i}" for i in range(6)]
        state = TYPES["sensor_msgs/msg/JointState"](header(t), names, q, np.zeros(0), np.zeros(0))
        messages += [(t, "/joint_states", state), (t, "/tf", tf(t, "world", "flange", mount @ link @ mount))]
        numbers = " ".join(f"{x:.9f}" for x in (*link[:3, 3], *turn.as_quat()))
        rows.append(f"{t // 10**9}.{t % 10**9:09d} {numbers}")
    (folder / "bags").mkdir()
    write(folder / "bags" / "hand", messages)
    (folder / "arm.urdf").write_text(URDF)
    (folder / "trajectory.txt").write_text("\n".join(rows) + "\n")
    text = (Path(__file__).resolve().parents[4] / "docs" / "calibration.md").read_text()
    commands = re.findall(r"^scripts/im calibrate (--bag .*)$", text, re.MULTILINE)
    assert len(commands) == 3
    printed = {}
    with contextlib.chdir(folder):
        for line in commands:
            words = shlex.split(line)
            with contextlib.redirect_stdout(io.StringIO()) as out:
                assert main(words) == 0, line
            printed[Path(words[words.index("--results") + 1]).name] = out.getvalue()
    return folder / "results", printed


@pytest.mark.parametrize("poses", ["tf", "joints", "file"])
def test_a_camera_on_a_robot(guide, poses):
    results, printed = guide
    (camera,) = reported(results / poses)["cameras"]
    off = np.array(camera["t_cam_base_m"]) - np.linalg.inv(LINK_CAMERA)[:3, 3]
    assert np.all(np.abs(off) < 6.0 * np.array([camera["standard_deviations"][name] for name in ("tx", "ty", "tz")]))
    assert np.abs(np.array(camera["K"]) - LEFT.K).max() < 6.0 * camera["standard_deviations"]["fx"]
    assert camera["standard_deviations"]["fx"] < 2.0
    observed = json.loads((results / poses / "observations.json").read_text())
    assert len(observed["target"]["views"]) == RESTS
    assert f"{RESTS} rests, the target is seen in {RESTS}" in printed[poses]
    assert f"{2 * (RESTS - 1)} while it moves" in printed[poses]


def calibrate(results, *more, target=TARGET):
    return main(["--target", target, "--results", str(results), *map(str, more)])


def reported(folder):
    report = json.loads((folder / "report.json").read_text())
    assert report["success"], report["message"]
    return report


def video(path, images, rate=30.0):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), rate, (LEFT.width, LEFT.height))
    assert writer.isOpened()
    for image in images:
        writer.write(np.dstack([image] * 3))
    writer.release()
    return path


def test_a_video_of_a_target_in_the_hand(run_of_robot, tmp_path, capsys):
    _, images = run_of_robot
    path = video(tmp_path / "left.avi", images.values(), rate=10.0)
    assert calibrate(tmp_path / "results", "--images", f"left={path}") == 0
    told = capsys.readouterr().out
    (camera,) = reported(tmp_path / "results")["cameras"]
    assert np.abs(np.array(camera["K"]) - LEFT.K).max() < 6.0 * camera["standard_deviations"]["fx"]
    views = len(json.loads((tmp_path / "results" / "observations.json").read_text())["target"]["views"])
    assert f"left: chessboard:8x5:0.03m taken in {views} views" in told
    assert RESTS <= views < len(images)
    assert "move by more than" in told
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 3 // 4])
    calibrate(tmp_path / "cut", "--images", f"left={path}")
    assert "left.avi: ends after" in capsys.readouterr().out
    path.write_bytes(whole[:600])
    assert calibrate(tmp_path / "cut", "--images", f"left={path}") == 1
    assert "left.avi: " in (error := capsys.readouterr().err)
    assert "is it cut off?" in error or "is the video cut off?" in error


class Recorded(ImageRecording):
    """Images a tenth of a second apart."""

    def __init__(self, pictures):
        self.name, self.pictures = "recorded", pictures
        self.stamps = np.arange(len(pictures), dtype=np.int64) * 100 * MS

    def images(self, chosen):
        return ((i, self.pictures[i]) for i in sorted(chosen))


def test_views_of_a_hand_are_those_at_rest(run_of_robot, monkeypatch):
    pictures, target = list(run_of_robot[1].values()), target_of(TARGET)
    first, second, blurred = pictures[0], pictures[4], np.full((240, 320), 90, np.uint8)
    alone = Recorded([first, first, blurred, second, blurred])
    (view,) = views_in_motion({"left": alone}, target).views
    assert view.images["left"][0] in (0, 1)
    monkeypatch.setattr("im_calibration.targets.recorded_views._MOST_DETECTIONS", 4)
    long = Recorded([first, first, *[blurred] * 3, second, first, *[blurred] * 3])
    chosen = views_in_motion({"left": long}, target)
    assert [view.images["left"][0] for view in chosen.views] == [0]
    assert "has 10 images, two in 5 are looked at" in chosen.told[0]


def nonsense(of, links, images):
    """Messages beside images, options, and what is told of them."""
    (first, _), stamps = next(iter(images.items())), list(images)
    pictures = [(t, "/left", image_message(image, "mono8", t)) for t, image in images.items()][:10]
    poses = [(t, "/tf", tf(t, "base", "tool", link)) for t, link in links.items()]
    robot = ["--eye-in-hand", "--base", "base", "--tool", "tool"]
    never = [
        (t, "/tf", tf(t, "base", "tool", transform(np.zeros(3), np.array([1e-10 * (t - first), 0, 0])))) for t in links
    ]
    halves = [(t, "/left", image_message(image[::2, ::2], "mono8", t)) for t, image in images.items()][10:12]
    later = [(t, "/tf", tf(t + 10**12, "base", "tool", link)) for t, link in links.items()]
    grey = np.zeros((4, 4), np.uint8)
    return {
        "topic": (
            pictures,
            ["--camera", "left:=/right"],
            "there is no topic '/right' in it; topics of images are /left",
        ),
        "no images": (poses, [], "there is no topic '/left' in it; no topic of it has images"),
        "type": (
            [(first, "/left", poses[0][2])],
            [],
            "'/left' is tf2_msgs/msg/TFMessage, not sensor_msgs/msg/Image or",
        ),
        "no tf": (pictures, robot, "there is no topic '/tf' in it"),
        "frame": (
            pictures + poses,
            [*robot[:-1], "tol"],
            "where 'tol' is in 'base': there is no frame 'tol' (did you mean",
        ),
        "apart": (
            [*pictures, (first, "/tf", tf(first, "x", "y", np.eye(4))), *poses],
            [*robot[:-1], "y"],
            "nothing connects them",
        ),
        "clocks": (pictures + later, robot, "no pose of the robot is of that time. Are both on one clock?"),
        "moving": (pictures + never, robot, "The robot moves by more than 1 mm or 2 mrad within 0.2 s of each"),
        "sizes": (
            pictures + halves,
            [],
            "image 11 has 160 x 120 px, those before 320 x 240: images of one camera have",
        ),
        "encoding": (
            [(first, "/left", image_message(grey, "32FC1"))],
            [],
            "images are of encoding '32FC1'; known are 16UC1",
        ),
        "bytes": (
            [(first, "/left", image_message(grey, "rgb8"))],
            [],
            "an image of 4 x 4 px, rgb8, has 24 bytes in rows of 6",
        ),
        "depth": ([(first, "/left", compressed(grey, "16UC1; compressedDepth png"))], [], "has images of depth"),
        "stamps": (
            [*pictures, (stamps[0], "/left", image_message(grey, "mono8", 0))],
            [],
            "1 of 11 messages on '/left' have no",
        ),
        "joints": (pictures, ["--urdf", "gantry.urdf", "--eye-in-hand", "--base", "l0", "--tool", "l6"], "gantry.urdf"),
    }[of]


@pytest.mark.parametrize(
    "of",
    ["topic", "no images", "type", "no tf", "frame", "apart", "clocks", "moving", "sizes", "encoding", "bytes", "depth",
     "stamps", "joints"],
)  # fmt: skip
def test_what_is_wrong_with_a_bag_is_one_sentence(run_of_robot, tmp_path, capsys, of):
    messages, options, sentence = nonsense(of, *run_of_robot)
    bag = write(tmp_path / "bag", messages)
    options = options if "--camera" in options else ["--camera", "left:=/left", *options]
    assert calibrate(tmp_path / "results", "--bag", bag, *options) == 1
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "results").exists()


def test_joint_states_in_degrees_are_told(tmp_path):
    (urdf := tmp_path / "arm.urdf").write_text(
        '<robot name="arm"><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/>'
        '<child link="b"/><axis xyz="0 0 1"/><limit lower="-3.1" upper="3.1" effort="1" velocity="1"/></joint></robot>'
    )
    for i, angle in enumerate((90.0, np.deg2rad(90.0))):
        state = TYPES["sensor_msgs/msg/JointState"](header(BEGIN), ["j"], np.array([angle]), np.zeros(0), np.zeros(0))
        bag = write(tmp_path / f"bag{i}", [(BEGIN, "/joint_states", state)])
        if angle > np.pi:
            with pytest.raises(DataError, match=r"j at 90 rad, its limits are -3.1 and 3.1 rad; are the states in d"):
                tree_of_joints(bag, urdf)
        else:
            pose = tree_of_joints(bag, urdf).poses("a", "b", np.array([BEGIN]))[0]
            np.testing.assert_allclose(pose[:3, :3], Rotation.from_euler("z", angle).as_matrix(), atol=1e-12)


GREY = np.random.default_rng(5).integers(0, 256, (6, 8)).astype(np.uint8)
RED = np.dstack([np.full((6, 8), 200), np.zeros((6, 8)), np.zeros((6, 8))]).astype(np.uint8)  # red, green, blue
LUMA_OF_RED = 0.299


def mosaic(pattern, rgb):
    """What a sensor behind a Bayer mosaic sees of a colour image; a pattern is the two rows of a cell."""
    seen = np.zeros(rgb.shape[:2], rgb.dtype)
    for k, color in enumerate(pattern):
        seen[k // 2 :: 2, k % 2 :: 2] = rgb[k // 2 :: 2, k % 2 :: 2, "rgb".index(color)]
    return seen


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        *((image_message(GREY, name), GREY) for name in ("mono8", "8UC1")),
        *((image_message(np.dstack([GREY] * n), name), GREY) for n, name in ((3, "rgb8"), (4, "bgra8"), (3, "8UC3"))),
        *((image_message(257 * GREY.astype(np.uint16), "mono16", big=big), 257 * GREY.astype(int)) for big in (0, 1)),
        (image_message(np.dstack([GREY // 2, GREY]), "yuv422"), GREY),
        (image_message(np.dstack([GREY, GREY // 2]), "yuv422_yuy2"), GREY),
        (image_message(RED, "rgb8"), LUMA_OF_RED * 200),
        (image_message(RED[..., ::-1], "bgr8"), LUMA_OF_RED * 200),
        (compressed(GREY, "mono8; png compressed "), GREY),
        (compressed(RED[..., ::-1], "rgb8; png compressed bgr8"), LUMA_OF_RED * 200),
        *((image_message(mosaic(p, RED), f"bayer_{p}8"), LUMA_OF_RED * 200) for p in ("rggb", "bggr", "gbrg", "grbg")),
        (image_message(mosaic("rggb", RED).astype(np.uint16) * 256, "bayer_rggb16"), LUMA_OF_RED * 200 * 256),
        (compressed(mosaic("gbrg", RED), "bayer_gbrg8; png compressed "), LUMA_OF_RED * 200),
    ],
)
def test_grey_images_of_messages(message, expected):
    image = grey_image(message, "/left")
    assert image.shape == (6, 8)
    inner = (slice(2, -2), slice(2, -2))  # a mosaic is not known at the rim
    np.testing.assert_allclose(image[inner], np.broadcast_to(expected, (6, 8))[inner], rtol=0.01, atol=1.0)


def test_an_image_that_cannot_be_read_is_told():
    message = compressed(GREY, "h264")
    message.data = np.frombuffer(b"\x00\x00\x00\x01\x67", np.uint8)
    with pytest.raises(DataError, match="/left: an image of format 'h264' cannot be read; JPEG and PNG can"):
        grey_image(message, "/left")
