"""Data sets from bags: spots go with the poses of their time; what cannot be is one sentence."""

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from im_calibration.commands import command, make_dataset
from im_calibration.problem.bags import pair
from im_calibration.problem.dataset import load_problems

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
RNG = np.random.default_rng(1)
SECOND = 10**9
N = 12
TURNS = Rotation.random(N, rng=2)
TOOLS = RNG.uniform(-1.0, 1.0, (N, 3))
SPOTS = {name: RNG.uniform(0.0, 400.0, (N, 2)) for name in ("left", "right")}
OFFSET = np.array([0.01, -0.02, 0.1])


def header(stamp_ns, frame="base"):
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=stamp_ns // SECOND, nanosec=stamp_ns % SECOND)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def point(stamp_ns, xyz, frame="base"):
    content = TYPES["geometry_msgs/msg/Point"](*map(float, xyz))
    return TYPES["geometry_msgs/msg/PointStamped"](header(stamp_ns, frame), content)


def spot(stamp_ns, uv):
    return point(stamp_ns, (*uv, 0.0), "camera")


def pose(stamp_ns, xyz, turn):
    place, way = TYPES["geometry_msgs/msg/Point"](*xyz), TYPES["geometry_msgs/msg/Quaternion"](*turn.as_quat())
    return TYPES["geometry_msgs/msg/PoseStamped"](header(stamp_ns), TYPES["geometry_msgs/msg/Pose"](place, way))


def transform(stamp_ns, parent, child, xyz, turn):
    shift, way = TYPES["geometry_msgs/msg/Vector3"](*xyz), TYPES["geometry_msgs/msg/Quaternion"](*turn.as_quat())
    content = TYPES["geometry_msgs/msg/Transform"](shift, way)
    each = TYPES["geometry_msgs/msg/TransformStamped"](header(stamp_ns, parent), child, content)
    return TYPES["tf2_msgs/msg/TFMessage"]([each])


def camera_info(width, height, model, binning=(0, 0), region=(0, 0)):
    part = TYPES["sensor_msgs/msg/RegionOfInterest"](0, 0, *region, False)
    return TYPES["sensor_msgs/msg/CameraInfo"](
        header(0), height, width, model, np.zeros(0), np.zeros(9), np.zeros(9), np.zeros(12), *binning, part
    )


def write(path, messages, plugin=StoragePlugin.MCAP):
    """A bag of ``(topic, message)``, recorded in this order."""
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for k, (topic, message) in enumerate(messages):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], k, STORE.serialize_cdr(message, kind))
    return path


def times():
    """Of the poses, a second apart; spots come up to 4 ms before and after."""
    return [(k + 1) * SECOND for k in range(N)]


def spots():
    late = {"left": 4_000_000, "right": -4_000_000}
    return [(f"/{name}/spot", spot(t + late[name], SPOTS[name][k])) for k, t in enumerate(times()) for name in SPOTS]


def poses():
    return [("/tool", pose(t, TOOLS[k], TURNS[k])) for k, t in enumerate(times())]


def infos():
    return [("/left/camera_info", camera_info(640, 480, "plumb_bob")), ("/info", camera_info(800, 600, "equidistant"))]


def run(bag, target, *options):
    named = [f"{name}=/{name}/spot" for name in SPOTS]
    return make_dataset.main(["bag", str(bag), str(target), "--spots", *named, *options])


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_spots_go_with_the_poses_of_their_time(plugin, tmp_path, capsys):
    bag = write(tmp_path / "bag", poses()[::-1] + spots() + infos(), plugin)
    target = tmp_path / "out.json"
    offset = ["--led-offset", *map(str, OFFSET), "--led-offset-sd", "0.002"]
    options = ["--poses", "/tool", "--camera-info", "right=/info", *offset, "--sigma-px", "0.1"]
    assert run(bag, target, *options) == command.OK
    out = capsys.readouterr().out
    assert "12 positions, 12 spots of left, 12 spots of right; robot noise not known" in out
    assert "spots and their poses are at most 4 ms apart, in which the light moved" in out
    (problem,) = load_problems(target)
    np.testing.assert_allclose(problem.positions, TOOLS + TURNS.apply(OFFSET))
    np.testing.assert_allclose(problem.wrist_rotations, TURNS.as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(problem.spots, [SPOTS["left"], SPOTS["right"]])
    assert problem.led_offset_prior_sd == 0.002
    assert problem.image_sizes == ((640, 480), (800, 600))
    assert problem.lens_models == ("plumb_bob", "equidistant")
    assert problem.noise_to_estimate == ("robot",)


def test_a_lens_model_that_is_not_known_is_told(tmp_path, capsys):
    told = [
        ("/left/camera_info", camera_info(640, 480, "double_sphere")),
        ("/right/camera_info", camera_info(8, 8, "")),
    ]
    bag = write(tmp_path / "bag", poses() + spots() + told)
    assert run(bag, tmp_path / "out.json", "--poses", "/tool") == command.OK
    out = capsys.readouterr().out
    assert "left has a lens of model 'double_sphere', of which nothing is known here; plumb_bob is taken for it" in out
    assert "right has a lens" not in out
    (problem,) = load_problems(tmp_path / "out.json")
    assert problem.lens_models == ("plumb_bob", "plumb_bob")


def test_images_of_a_binned_camera_or_of_a_region_are_smaller_than_it_was_calibrated_with(tmp_path):
    """The region is a height and a width, as its message has them."""
    binned = camera_info(1280, 960, "plumb_bob", binning=(2, 3))
    part = camera_info(1280, 960, "plumb_bob", binning=(2, 2), region=(480, 800))
    told = [("/left/camera_info", binned), ("/right/camera_info", part)]
    bag = write(tmp_path / "bag", poses() + spots() + told)
    assert run(bag, tmp_path / "out.json", "--poses", "/tool") == command.OK
    (problem,) = load_problems(tmp_path / "out.json")
    assert problem.image_sizes == ((640, 320), (400, 240))


def test_the_light_itself_may_be_told_and_transforms_be_followed(tmp_path):
    light = TOOLS + TURNS.apply(OFFSET)
    points = [("/light", point(t, light[k])) for k, t in enumerate(times())]
    # base -> arm moves, arm -> led is fixed: told once, and after the rest
    moving = [("/tf", transform(t, "base", "arm", TOOLS[k], TURNS[k])) for k, t in enumerate(times())]
    others = [("/tf", transform(t + 1, "base", "other", TOOLS[k], TURNS[k])) for k, t in enumerate(times())]
    fixed = [("/tf_static", transform(0, "arm", "led", OFFSET, Rotation.identity()))]
    bag = write(tmp_path / "bag", spots() + points + moving + others + fixed)
    for options in (["--poses", "/light"], ["--poses", "/tf", "--frames", "base", "led"]):
        assert run(bag, tmp_path / "out.json", *options, "--image-size", "640x480") == command.OK
        (problem,) = load_problems(tmp_path / "out.json")
        np.testing.assert_allclose(problem.positions, light)


def test_messages_without_stamps_are_of_the_time_of_their_recording(tmp_path, capsys):
    messages = []
    for k in range(N):
        messages += [("/tool", pose(0, TOOLS[k], TURNS[k]))]
        messages += [(f"/{name}/spot", spot(0, SPOTS[name][k])) for name in SPOTS]
    bag = write(tmp_path / "bag", messages)
    options = ["--poses", "/tool", "--image-size", "640x480", "--tolerance", "2e-9"]
    assert run(bag, tmp_path / "out.json", *options) == command.OK
    (problem,) = load_problems(tmp_path / "out.json")
    np.testing.assert_allclose(problem.positions, TOOLS)
    np.testing.assert_array_equal(problem.spots, [SPOTS["left"], SPOTS["right"]])


def test_a_spot_without_a_pose_of_its_own_is_left_out():
    ms = 1_000_000
    poses = np.array([100, 200, 300]) * ms
    left, right = np.array([98, 104, 150, 203]) * ms, np.array([99, 197, 308, 311]) * ms
    found = pair([left, right], poses, 0.01)
    np.testing.assert_array_equal(found.pose_of, [0, 1, 2])
    # 104 is of the same pose as 98, which another camera has near it, too; 150 and 311 have none
    np.testing.assert_array_equal(found.spot_of, [[0, 3, -1], [0, 1, 2]])
    assert found.left_out == 3
    assert found.apart_s == pytest.approx(0.008)


def test_a_moving_light_is_said_to_move(tmp_path, capsys):
    moving = [("/tool", pose(t, [k * 0.5, 0.0, 0.0], TURNS[k])) for k, t in enumerate(times())]
    bag = write(tmp_path / "bag", moving + spots())
    assert run(bag, tmp_path / "out.json", "--poses", "/tool", "--image-size", "640x480") == command.OK
    assert "in which the light moved 2 mm" in capsys.readouterr().out


def nonsense(of):
    """What is wrong, by name, with options and the sentence."""
    several = [("/tool", point(t, TOOLS[k], f"base{k % 2}")) for k, t in enumerate(times())]
    unstamped = [("/tool", pose(t * (k > 0), TOOLS[k], TURNS[k])) for k, t in enumerate(times())]
    long = pose(SECOND, TOOLS[0], TURNS[0])
    long.pose.orientation.w += 1.0
    points = [("/tool", point(t, TOOLS[k])) for k, t in enumerate(times())]
    moving = [("/tool", transform(t, "base", "arm", TOOLS[k], TURNS[k])) for k, t in enumerate(times())]
    shifted = [("/tool", pose(t + SECOND // 2, TOOLS[k], TURNS[k])) for k, t in enumerate(times())]
    return {
        "no topic": ([], [], "there is no topic '/tool' in it (known: /left/spot, /right/spot)"),
        "type": ([("/tool", spots()[0][1])], ["--camera-info", "left=/tool"], "is geometry_msgs/msg/PointStamped, not"),
        "frames": (several, [], "'/tool' is in several frames: base0, base1; one is needed"),
        "stamps": (unstamped, [], "1 of 12 messages on '/tool' have no stamp"),
        "quaternion": ([("/tool", long)], [], "the orientation of '/tool' has length"),
        "points": (points, ["--led-offset", "0", "0", "1"], "'/tool' has points; an LED offset needs poses"),
        "transforms": (moving, [], "'/tool' has transforms; give --frames BASE TOOL"),
        "way": (
            moving,
            ["--frames", "base", "led"],
            "does not say where 'led' is in 'base': there is no frame 'led' (known: arm, base)",
        ),
        "apart": (shifted, [], "no spot has a pose within 0.02 s; the first spot comes -0.504 s after the first pose"),
        "nan": ([("/tool", point(1, [np.nan] * 3))], [], "topic '/tool' has no message with finite numbers"),
        "size": (poses(), [], "The image size of left, right is not known; give --image-size WIDTHxHEIGHT."),
        "camera": (poses(), ["--camera-info", "up=/info"], "--camera-info names up, --spots left, right."),
        "offset": (poses(), ["--led-offset", "0", "nan", "1"], "--led-offset has a number that is not finite"),
    }[of]


@pytest.mark.parametrize(
    "of",
    ["no topic", "type", "frames", "stamps", "quaternion", "points", "transforms", "way", "apart", "nan", "size",
     "camera", "offset"],
)  # fmt: skip
def test_what_does_not_go_together_is_one_sentence(of, tmp_path, capsys):
    messages, options, sentence = nonsense(of)
    bag = write(tmp_path / "bag", spots() + messages)
    assert run(bag, tmp_path / "out.json", "--poses", "/tool", *options) == command.BAD_INPUT
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out.json").exists()


@pytest.mark.parametrize(("silent", "messages"), [("/left/spot", poses), ("/tool", spots)])
def test_a_topic_on_which_nothing_came_is_one_sentence(silent, messages, tmp_path, capsys):
    """A recorder announces what there is a publisher of."""
    bag = tmp_path / "bag"
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kinds = {silent: "geometry_msgs/msg/PointStamped", **{topic: each.__msgtype__ for topic, each in messages()}}
        connections = {topic: writer.add_connection(topic, kind, typestore=STORE) for topic, kind in kinds.items()}
        for k, (topic, message) in enumerate(messages()):
            writer.write(connections[topic], k, STORE.serialize_cdr(message, message.__msgtype__))
    assert run(bag, tmp_path / "out.json", "--poses", "/tool") == command.BAD_INPUT
    assert capsys.readouterr().err == f"make_dataset: {bag}: there is nothing on topic '{silent}' in it.\n"


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_spoilt_bag_is_one_sentence(plugin, tmp_path, capsys):
    bag = write(tmp_path / "bag", spots() + poses() + infos(), plugin)
    (data,) = (path for path in bag.iterdir() if path.name != "metadata.yaml")
    good, meta = data.read_bytes(), (bag / "metadata.yaml").read_bytes()
    spoilt = [good[: len(good) * part // 10] for part in range(10)]
    for k in range(20):
        bytes_ = bytearray(good)
        for place in np.random.default_rng(k).integers(0, len(good), 50):
            bytes_[place] ^= 0xFF
        spoilt.append(bytes(bytes_))
    for content in spoilt:
        data.write_bytes(content)
        if run(bag, tmp_path / "out.json", "--poses", "/tool", "--image-size", "640x480") != command.OK:
            error = capsys.readouterr().err
            assert error.startswith("make_dataset: ")
            assert error.count("\n") == 1
    data.write_bytes(good)
    for content in (b"", b"- 1", b"{", b"rosbag2_bagfile_information: 1", meta[: len(meta) // 2]):
        (bag / "metadata.yaml").write_bytes(content)
        assert run(bag, tmp_path / "out.json", "--poses", "/tool", "--image-size", "640x480") == command.BAD_INPUT
        error = capsys.readouterr().err
        assert error.startswith(f"make_dataset: {bag}")
        assert error.count("\n") == 1
    assert run(tmp_path / "none", tmp_path / "out.json", "--poses", "/tool") == command.BAD_INPUT
    assert f"{tmp_path / 'none'}: cannot be read: " in capsys.readouterr().err
    assert run(data, tmp_path / "out.json", "--poses", "/tool", "--image-size", "640x480") == command.OK


def test_successive_poses_that_are_the_same_are_one_reading(tmp_path):
    same = [("/tool", pose(t, TOOLS[k // 3], TURNS[k // 3])) for k, t in enumerate(times())]
    target, sized = tmp_path / "out.json", ["--poses", "/tool", "--image-size", "640x480"]
    assert run(write(tmp_path / "bag", same + spots()), target, *sized) == command.OK
    assert load_problems(target)[0].readings == tuple("111222333444")
    assert run(write(tmp_path / "other", poses() + spots()), target, *sized) == command.OK
    assert load_problems(target)[0].readings == ()
