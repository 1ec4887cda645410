"""A calibration again out of a bag: the same numbers, or other options beside them; what cannot be is one sentence."""

import json

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, Quaternion, TransformStamped
from rclpy.serialization import serialize_message
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image
from service_msgs.msg import ServiceEventInfo
from tf2_msgs.msg import TFMessage

from im_bag import BagWriter, Delivery
from im_bag import writer as bag_writer
from im_calibration import TARGET_NOISE, calibrate, problem_of, problem_of_views, report_of, views_of
from im_calibration.targets.target import chessboard_of
from im_cell.camera_model import CameraModel, nominal
from im_cell.robot import load_cell
from im_core.config import package_file
from im_core.errors import StateError
from im_msgs.msg import CalibrationReport, Observation, Spot, SpotCandidates, Status, TargetView
from im_msgs.srv import Calibrate, SpotFind
from im_vss.ros import recalibrate
from im_vss.ros.ports.calibration import from_request
from im_vss.settings import load_settings

CALLS, CALL = "/vss/calibrate/_service_event", "im_msgs/srv/Calibrate_Event"
LOOKS, LOOK = "/vss/spot_find/_service_event", "im_msgs/srv/SpotFind_Event"
IMAGE, CAMERA_INFO, TRANSFORMS = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"
CELL = load_cell()
SETTINGS = load_settings(CELL)
CAMERAS = ("ceiling_left", "ceiling_right")
MODELS = {name: nominal(CELL.cameras[name]) for name in CAMERAS}
OFFSET, PRIOR_SD = (0.01, 0.05, 0.04), 0.003
OFF_BY = np.array((0.001, -0.002, 0.001))
NOISE_PX, POSES, BOARD_POSES, SEED = 0.05, 26, 12, 15
DELIVERY = Delivery(reliable=True, latched=False, depth=10)


def request():
    """What the ceiling cameras see of a light at random places over the table; its place in the wrist is off."""
    dice = np.random.default_rng(SEED)
    turns = Rotation.random(POSES, rng=dice)
    wrists = dice.uniform((-0.6, -0.6, 0.8), (0.6, 0.6, 1.6), (POSES, 3))
    lights = wrists + turns.apply(np.array(OFFSET) + OFF_BY)
    observations = []
    for i, (wrist, turn) in enumerate(zip(wrists, turns, strict=True)):
        x, y, z, w = turn.as_quat()
        spots = []
        for name, model in MODELS.items():
            u, v = model.project(lights[i]) + dice.normal(0.0, NOISE_PX, 2)
            assert 20 < u < 620, "in view"
            spot = Spot(camera=name, found=True, u=u, v=v, covariance=[NOISE_PX**2, 0.0, 0.0, NOISE_PX**2])
            spot.stamp.sec = 10 + i
            spots.append(spot)
        where = Pose(position=Point(x=wrist[0], y=wrist[1], z=wrist[2]), orientation=Quaternion(x=x, y=y, z=z, w=w))
        observations.append(
            Observation(
                pose=f"p{i}", wrist=where, position_covariance=(1e-10 * np.eye(3)).ravel().tolist(), spots=spots
            )
        )
    return Calibrate.Request(cameras=list(CAMERAS), observations=observations)


def answered(asked):
    sizes = {name: (model.width, model.height) for name, model in MODELS.items()}
    request = from_request(asked)
    led, box = (OFFSET, PRIOR_SD), CELL.workspace_box
    problem = problem_of(request.cameras, request.observations, request.lengths, sizes, led, SETTINGS.cameras, box)
    report = report_of(calibrate(problem), problem)
    assert report["success"]
    return report


@pytest.fixture(scope="module")
def asked():
    return request()


@pytest.fixture(scope="module")
def report(asked):
    return answered(asked)


def events(kind, calls):
    """Requests and responses of a Service, as its introspection tells them."""
    for number, (asked, answer) in enumerate(calls, 1):
        sides = [
            (ServiceEventInfo.REQUEST_RECEIVED, "request", asked),
            (ServiceEventInfo.RESPONSE_SENT, "response", answer),
        ]
        for event, side, content in sides:
            if content is not None:
                info = ServiceEventInfo(event_type=event, sequence_number=number)
                yield serialize_message(kind.Event(info=info, **{side: [content]}))


def write_bag(path, *calls, others=()):
    """A bag of calls of ``calibrate`` and of other messages ``(topic, type, bytes)``."""
    writer, topics = BagWriter(path), set()
    told = [*((topic, kind, data) for topic, kind, data in others)]
    told += [(CALLS, CALL, data) for data in events(Calibrate, calls)]
    for number, (topic, kind, data) in enumerate(told):
        if topic not in topics:
            writer.add_topic(topic, kind, DELIVERY)
            topics.add(topic)
        writer.write(topic, 10**18 + number, data)
    writer.close()
    return str(path)


def answer(report):
    return Calibrate.Response(success=True, report=CalibrationReport(success=True, json=json.dumps(report)))


def run(bag, out, *options):
    return recalibrate.main([str(bag), "--recalibrate", "-o", str(out), *map(str, options)])


def test_the_same_options_give_the_same_numbers(tmp_path, asked, report, capsys):
    bag = write_bag(tmp_path / "bag", (asked, answer(report)))
    assert run(bag, tmp_path / "out") == recalibrate.OK
    assert "the same numbers as recorded (largest relative difference 0)" in capsys.readouterr().out
    assert json.loads((tmp_path / "out/report.json").read_text()) == json.loads(json.dumps(report))
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written >= {"report.json", "summary.txt", "observations.json", "extrinsics.yaml", "ceiling_left.yaml"}


def test_numbers_that_are_not_the_same_are_told(tmp_path, asked, report, capsys):
    cameras = json.loads(json.dumps(report["cameras"]))
    cameras[1]["K"][0][0] *= 1.0 + 1e-8
    bag = write_bag(tmp_path / "bag", (asked, answer({**report, "cameras": cameras})))
    assert run(bag, tmp_path / "out") == recalibrate.FAILED
    assert "NOT the same numbers as recorded: cameras[1].K" in capsys.readouterr().out


def test_other_options_make_a_new_calibration_beside_the_recorded_one(tmp_path, asked, report, capsys):
    bag = write_bag(tmp_path / "bag", (asked, answer(report)), (asked, None))
    options = ("--number", 1, "--cameras", "ceiling_right", "--lens-model", "equidistant", "--noise", "estimated")
    run(bag, tmp_path / "out", *options)
    told = capsys.readouterr().out
    assert "calibration 1 of 2" in told
    (camera,) = json.loads((tmp_path / "out/report.json").read_text())["cameras"]
    assert (camera["name"], camera["distortion_model"]) == ("ceiling_right", "equidistant")
    rows = [line.split() for line in told.splitlines() if line.startswith(("ceiling_left fx", "ceiling_right equi"))]
    assert [row[4] for row in rows[:1]] == ["-"], "what was not calibrated now has no new value"
    assert rows[1][3] == "-", "what was not estimated then has no old one"


@pytest.fixture
def by_board(monkeypatch):
    """A request of a calibration by the board of the cell at random places over the table, and its answer."""
    monkeypatch.setenv("IM_OBJECTS", str(package_file("im_cell", "cells/puma_pair/board.yaml")))
    board, dice = chessboard_of(load_cell(), "board"), np.random.default_rng(SEED)
    in_wrist, observations = Rotation.from_euler("xyz", (0.02, 0.03, 0.1)), []
    for i in range(BOARD_POSES):
        turn = Rotation.from_euler("xyz", dice.uniform(-0.4, 0.4, 3))
        wrist = dice.uniform((-0.4, -0.4, 0.8), (0.4, 0.4, 1.4))
        corners = wrist + turn.apply(in_wrist.apply(board.points) + np.array((0.01, -0.02, 0.17)))
        views = []
        for name, model in MODELS.items():
            u, v = np.array([model.project(corner) for corner in corners]).T
            u, v = (each + dice.normal(0.0, NOISE_PX, len(corners)) for each in (u, v))
            views.append(TargetView(camera=name, found=True, u=u, v=v, sd=np.full(len(u), NOISE_PX)))
            views[-1].stamp.sec = 10 + i
        x, y, z, w = turn.as_quat()
        where = Pose(position=Point(x=wrist[0], y=wrist[1], z=wrist[2]), orientation=Quaternion(x=x, y=y, z=z, w=w))
        sure = (1e-10 * np.eye(6)).ravel().tolist()
        observations.append(Observation(pose=f"p{i}", wrist=where, wrist_covariance=sure, views=views))
    asked = Calibrate.Request(cameras=list(CAMERAS), observations=observations, target="board")
    sizes = {name: (model.width, model.height) for name, model in MODELS.items()}
    views = views_of(CAMERAS, from_request(asked).observations, board, sizes, SETTINGS.cameras)
    problem = problem_of_views(views, TARGET_NOISE)
    report = report_of(calibrate(problem), problem)
    assert report["success"], report["message"]
    return asked, report


def test_a_calibration_by_a_board_gives_the_same_numbers(tmp_path, by_board, capsys, monkeypatch):
    asked, report = by_board
    bag = write_bag(tmp_path / "bag", (asked, answer(report)))
    assert run(bag, tmp_path / "out") == recalibrate.OK
    assert "the same numbers as recorded (largest relative difference 0)" in capsys.readouterr().out
    assert json.loads((tmp_path / "out/observations.json").read_text())["target"]
    run(bag, tmp_path / "other", "--lens-model", "equidistant", "--cameras", "ceiling_left")
    (camera,) = json.loads((tmp_path / "other/report.json").read_text())["cameras"]
    assert (camera["name"], camera["distortion_model"]) == ("ceiling_left", "equidistant")
    assert run(bag, tmp_path / "images", "--from", "images") == recalibrate.BAD_INPUT
    assert "a board is not looked for again in images" in capsys.readouterr().err
    monkeypatch.delenv("IM_OBJECTS")
    assert run(bag, tmp_path / "none") == recalibrate.BAD_INPUT
    assert "no chessboard 'board'" in capsys.readouterr().err


def drawn(model, light, number):
    """A pair of images, without the light and with it, and where it is in the second."""
    u, v = model.project(light)
    y, x = np.mgrid[: model.height, : model.width]
    noise = np.random.default_rng(number).normal(0.0, 1.0, (2, model.height, model.width))
    spot = 120.0 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2.0 * SETTINGS.spot.sigma_expected**2))
    return np.clip(np.rint(20.0 + noise + np.stack((0.0 * spot, spot))), 0, 255).astype(np.uint8)


def image(pixels, stamp_ns):
    message = Image(height=pixels.shape[0], width=pixels.shape[1], encoding="mono8", step=pixels.shape[1])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    message.data = pixels.tobytes()
    return serialize_message(message)


def test_spots_are_found_again_in_the_recorded_images(tmp_path, asked, report, capsys):
    """The images are those of other places than the spots tell: it is they that count. One pair is not there."""
    shift, others, discs = np.array((0.05, 0.0, 0.0)), [], []
    wanted = from_request(asked)
    offset = np.array(OFFSET) + OFF_BY
    for i, observation in enumerate(wanted.observations):
        light = observation.position + observation.rotation @ offset + shift
        for name, model in MODELS.items():
            stamp = (10 + i) * 10**9
            discs.append(SpotCandidates(camera=name, predicted=True, radius=400.0, u=320.0, v=240.0))
            discs[-1].stamp.sec = 10 + i
            if (i, name) != (3, "ceiling_left"):
                off, on = drawn(model, light, 2 * i)
                others += [(f"/{name}/image_raw", IMAGE, image(off, stamp - 20_000_000))]
                others += [(f"/{name}/image_raw", IMAGE, image(on, stamp))]
    looks = events(SpotFind, [(None, SpotFind.Response(candidates=discs))])
    bag = write_bag(tmp_path / "bag", (asked, answer(report)), others=[*others, *((LOOKS, LOOK, d) for d in looks)])
    assert run(bag, tmp_path / "out", "--from", "images") == recalibrate.OK
    told = capsys.readouterr().out
    assert f"{2 * POSES - 1} spots found in the images, 1 of the recorded ones not" in told
    assert "1 looks are left out, their images are not in the bag" in told
    again = json.loads((tmp_path / "out/report.json").read_text())
    point = np.array((0.2, 0.1, 1.2))
    for camera in again["cameras"]:
        pose = np.array(camera["R_cam_base"]), np.array(camera["t_cam_base_m"])
        found = CameraModel(640, 480, np.array(camera["K"]), np.array(camera["D"]), *pose)
        true = MODELS[camera["name"]].project(point + shift)
        np.testing.assert_allclose(found.project(point), true, atol=0.5)
        assert abs(MODELS[camera["name"]].project(point) - true).max() > 5.0, "that is not where the spots were"


@pytest.mark.parametrize(
    ("topic", "kind", "text"),
    [
        (CALLS, "im_msgs/srv/Calibrate_Request", "sequence<im_msgs::msg::KnownLength> known_lengths;"),
        (LOOKS, "im_msgs/srv/SpotFind_Response", "sequence<im_msgs::msg::SpotCandidates> candidates;"),
    ],
)
def test_a_bag_of_another_version_is_told_by_the_field(tmp_path, asked, report, capsys, monkeypatch, topic, kind, text):
    define, name = bag_writer.full_definition, text.split()[-1][:-1]

    def other_definition(of):
        definition = define(of)
        assert text in definition.text or of != {CALLS: CALL, LOOKS: LOOK}[topic]
        return definition._replace(text=definition.text.replace(text, ""))

    monkeypatch.setattr(bag_writer, "full_definition", other_definition)
    looks = [(LOOKS, LOOK, event) for event in events(SpotFind, [(None, SpotFind.Response())])]
    looks += [size_of(name) for name in CAMERAS]
    bag = write_bag(tmp_path / "bag", (asked, answer(report)), others=looks)
    assert run(bag, tmp_path / "out", "--from", "images") == recalibrate.BAD_INPUT
    assert f"{kind} is defined there without '{name}'" in capsys.readouterr().err


def size_of(name):
    info = CameraInfo(width=MODELS[name].width, height=MODELS[name].height)
    return f"/{name}/camera_info", CAMERA_INFO, serialize_message(info)


def test_a_calibration_that_was_refused_can_be_tried_again(tmp_path, asked, capsys):
    """It has no report: what that would tell comes from camera infos, and from this workspace, which is said."""
    refused = Calibrate.Response(success=False, status=Status(message="too few spots"))
    bag = write_bag(tmp_path / "bag", (asked, refused), others=[size_of(name) for name in CAMERAS])
    run(bag, tmp_path / "out")
    told = capsys.readouterr().out
    assert (
        "the bag does not tell where the light is in the wrist; as this workspace has it: [0.0, 60.0, 50.0] mm" in told
    )
    assert "holds no estimate to compare with: too few spots" in told
    assert (tmp_path / "out/report.json").is_file()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--cameras", "wall"), "wall was not calibrated in it; there are ceiling_left, ceiling_right"),
        (("--cameras", "ceiling_left", "ceiling_left"), "a camera is given twice"),
        (("--number", 2), "it holds the calibrations 1 to 1, --number is 2"),
        (("--from", "images"), "the images of its 52 looks are not in it (/ceiling_left/image_raw"),
    ],
)
def test_what_the_bag_does_not_hold_is_one_sentence(tmp_path, asked, report, options, sentence, capsys):
    bag = write_bag(tmp_path / "bag", (asked, answer(report)))
    assert run(bag, tmp_path / "out", *options) == recalibrate.BAD_INPUT
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "cameras",
    [5, ["ceiling_left"], [{"name": "ceiling_left"}], [{"name": "ceiling_left", "width": "x", "height": 2}]],
)
def test_a_report_that_is_none_is_passed_over(tmp_path, asked, report, cameras, capsys):
    bag = write_bag(tmp_path / "bag", (asked, answer({**report, "cameras": cameras})))
    assert run(bag, tmp_path / "out", "--lens", "plumb_bob") == recalibrate.BAD_INPUT
    told = "neither a report nor /ceiling_left/camera_info says how large the images of ceiling_left are"
    assert told in capsys.readouterr().err


@pytest.mark.parametrize("left_out", ["led_offset_m", "cameras", "expected_error"])
def test_a_report_of_another_version_is_not_compared(tmp_path, asked, report, left_out, capsys):
    recorded = {key: value for key, value in report.items() if key != left_out}
    bag = write_bag(tmp_path / "bag", (asked, answer(recorded)), others=[size_of(name) for name in CAMERAS])
    assert run(bag, tmp_path / "out", "--noise", "estimated") == recalibrate.OK
    told = f"the recorded report cannot be compared, it is none of this version: KeyError('{left_out}')"
    assert told in capsys.readouterr().out


def test_observations_that_determine_no_estimate_are_no_wrong_arguments(tmp_path, asked, report, capsys):
    few = Calibrate.Request(cameras=asked.cameras, observations=asked.observations[:3])
    bag = write_bag(tmp_path / "bag", (few, answer(report)))
    assert run(bag, tmp_path / "out") == recalibrate.FAILED
    assert "there is no estimate: Camera ceiling_left saw the LED in 3 poses" in capsys.readouterr().err


def arm(x, sec, turned=(0.0, 0.0, 0.0, 1.0)):
    """A message that puts the last link of the left arm somewhere in the world at a testbed time [s]."""
    link = TransformStamped(child_frame_id="left_link6")
    link.header.frame_id, link.header.stamp.sec = "world", sec
    link.transform.translation.x = x
    link.transform.rotation = Quaternion(**dict(zip("xyzw", turned, strict=True)))
    return "/tf", TRANSFORMS, serialize_message(TFMessage(transforms=[link]))


def mounted(bag, *secs):
    """Where the left wrist was along x at testbed times [s], by the bag [m]."""
    return recalibrate.mount_in(bag, 2 * 10**18, CELL, 1e8)("left_wrist", [10**9 * sec for sec in secs])[1][0]


def test_the_mount_of_a_camera_is_where_it_was_at_the_exposures(tmp_path):
    bag = tmp_path / "bag"
    write_bag(bag, others=[arm(1.0, 10), arm(1.0, 11), arm(5.0, 12), arm(9.0, 11, turned=(0.0, 0.0, 0.0, 0.0))])
    here = mounted(bag, 10)
    assert mounted(bag, 10, 11) == mounted(bag, 11, 77) == here
    assert mounted(bag, 12) == pytest.approx(here + 4.0)
    with pytest.raises(StateError, match=r"left_wrist moved between the exposures, by 4000\.0 mm and 0\.0 mrad"):
        mounted(bag, 11, 12)
    with pytest.raises(StateError, match="the pose of left_wrist during the exposure of its cameras is not known"):
        mounted(bag, 77)


def test_images_of_no_height_are_refused(tmp_path, asked, report, capsys):
    empty = Image(encoding="mono8", width=5, step=5)
    others = [(f"/{name}/image_raw", IMAGE, serialize_message(empty)) for name in CAMERAS]
    others.append((LOOKS, LOOK, next(iter(events(SpotFind, [(SpotFind.Request(), None)])))))
    bag = write_bag(tmp_path / "bag", (asked, answer(report)), others=others)
    assert run(bag, tmp_path / "out", "--from", "images") == recalibrate.BAD_INPUT
    assert "/ceiling_left/image_raw: an image of 5 x 0 px, mono8, has 0 bytes in rows of 5" in capsys.readouterr().err


def test_bags_without_a_calibration_are_one_sentence(tmp_path, asked, capsys):
    other = write_bag(tmp_path / "other", others=[size_of("ceiling_left")])
    sizeless = write_bag(tmp_path / "sizeless", (asked, None))
    spoilt = write_bag(tmp_path / "spoilt", (asked, answer({})))
    (tmp_path / "spoilt/spoilt.mcap").write_bytes(b"no bag at all")
    for bag, sentence in (
        (tmp_path / "nowhere", "nowhere"),
        (other, f"it holds no calibration, there is no topic {CALLS} in it"),
        (sizeless, "neither a report nor /ceiling_left/camera_info says how large the images of ceiling_left are"),
        (spoilt, "cannot be read"),
    ):
        assert run(bag, tmp_path / "out") == recalibrate.BAD_INPUT
        told = capsys.readouterr().err
        assert sentence in told
        assert told.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_results_are_not_written_over_others(tmp_path, asked, report, capsys):
    bag = write_bag(tmp_path / "bag", (asked, answer(report)))
    (tmp_path / "out").mkdir()
    (tmp_path / "out/report.json").write_text("mine")
    assert run(bag, tmp_path / "out") == recalibrate.BAD_INPUT
    assert "name another folder with -o" in capsys.readouterr().err
    assert (tmp_path / "out/report.json").read_text() == "mine"
