"""``im calibrate --images``: from folders of rendered images to files of cameras, and what is told of bad ones."""

import contextlib
import io
import json
import re
import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.calibration.boards import Sensor, render
from bench.calibration.target_views import transform
from im_calibration.commands.calibrate_dataset import main
from im_calibration.commands.images import _given
from im_calibration.reporting import results
from im_calibration.reporting.plots import plot_overlay
from im_calibration.targets.detection import detect
from im_calibration.targets.target import target_of
from im_cell.calibration_files import camera_info_yaml
from im_cell.camera_model import CameraModel

pytestmark = pytest.mark.usefixtures("without_pictures")

TARGET = "chessboard:8x5:30mm"
D = np.array([-0.2, 0.05, 0.0, 0.0, 0.0])
LEFT = CameraModel(320, 240, np.array([[300.0, 0.0, 162.0], [0.0, 301.0, 117.0], [0.0, 0.0, 1.0]]), D)
STEP = transform(np.array([0.02, 0.08, 0.01]), np.array([-0.06, 0.0, 0.01]))
RIGHT = CameraModel(320, 240, LEFT.K, D, STEP[:3, :3], STEP[:3, 3])
LINK_CAMERA = transform(np.array([0.2, -0.3, 0.1]), np.array([0.02, 0.05, 0.1]))
BASE_TARGET = transform(np.array([0.1, 0.1, 1.0]), np.array([0.4, 0.1, 0.0]))
CAMERA_BASE = transform(np.array([2.0, 0.3, -0.2]), np.array([0.1, 0.2, 1.0]))
LINK_TARGET = transform(np.array([0.3, -0.2, 0.5]), np.array([0.02, 0.01, 0.06]))


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A folder of images of each of two cameras, and the poses of a link with both cameras on it."""
    folder = tmp_path_factory.mktemp("images")
    target, rng = target_of(TARGET), np.random.default_rng(3)
    lines = {name: ["image,x,y,z,qx,qy,qz,qw"] for name in ("poses", "fixed")}
    for name in ("left", "right"):
        (folder / "images" / name).mkdir(parents=True)
    for i in range(8):
        pose = transform(rng.normal(0.0, 0.3, 3), np.zeros(3))
        pose[:3, 3] = [*rng.uniform(-0.04, 0.04, 2), rng.uniform(0.4, 0.55)] - pose[:3, :3] @ target.points.mean(axis=0)
        for k, (name, camera) in enumerate((("left", LEFT), ("right", RIGHT))):
            image = render(target, camera, pose[:3, :3], pose[:3, 3], Sensor(), 10 * i + k)
            cv2.imwrite(str(folder / "images" / name / f"view{i}.png"), image)
        links = {
            "poses": BASE_TARGET @ np.linalg.inv(LINK_CAMERA @ pose),
            "fixed": np.linalg.inv(CAMERA_BASE) @ pose @ np.linalg.inv(LINK_TARGET),
        }
        for name, link in links.items():
            place = link[:3, 3] + rng.normal(0.0, 2e-4, 3)
            numbers = [*place, *Rotation.from_matrix(link[:3, :3]).as_quat()]
            lines[name].append(f"view{i}.png," + ",".join(f"{number:.9g}" for number in numbers))
    for name, content in lines.items():
        (folder / f"{name}.csv").write_text("\n".join(content) + "\n")
    return folder


def calibrate(folder, results, *more, cameras=("left",), target=TARGET):
    """Exit code of the command for cameras with images in folders of a folder."""
    images = [f"{name}={folder / name}" for name in cameras]
    return main(["--images", *images, "--target", target, "--results", str(results), *map(str, more)])


@pytest.fixture(scope="module")
def guide(scene):
    """The folder of results after the commands of the guide, all of which end well."""
    text = (Path(__file__).resolve().parents[4] / "docs" / "calibration.md").read_text()
    commands = re.findall(r"^scripts/im calibrate (--images .*)$", text, re.MULTILINE)
    assert len(commands) == 5
    with contextlib.chdir(scene):
        for line in commands:
            assert main(shlex.split(line)) == 0, line
    return scene / "results"


def reported(folder):
    """The report in a folder of results."""
    report = json.loads((folder / "report.json").read_text())
    assert report["success"], report["message"]
    return report


def deviations(camera, *names):
    """Standard deviations of a camera's parameters."""
    return np.array([camera["standard_deviations"][name] for name in names])


def test_intrinsics_and_a_pair(guide):
    (alone,) = reported(guide / "left")["cameras"]
    left, right = reported(guide / "pair")["cameras"]
    for camera in (alone, left):
        assert np.abs(np.array(camera["K"]) - LEFT.K).max() < 6.0 * deviations(camera, "fx", "cx", "cy").max()
    off = np.array(right["t_cam_base_m"]) - RIGHT.t_cam_base
    assert np.all(np.abs(off) < 6.0 * deviations(right, "tx", "ty", "tz"))
    assert (guide / "left" / "left.yaml").is_file()
    assert "frame_id: left" in (guide / "pair" / "extrinsics.yaml").read_text()


def test_the_overlay_shows_a_view_of_each_camera(scene, tmp_path, monkeypatch):
    def overlay(calibration, problem, shown):
        for c, name in enumerate(("left", "right")):
            view, image = shown[name]
            of_view = [i for i, pose in enumerate(problem.pose_names) if pose.startswith(f"{view} point ")]
            np.testing.assert_array_equal(detect(image, target_of(TARGET)).points, problem.spots[c][of_view])
        plot_overlay(calibration, problem, shown, picture := io.BytesIO())
        return {"overlay.png": picture.getvalue()}

    monkeypatch.setattr(results, "_pictures", overlay)
    assert calibrate(scene / "images", tmp_path, cameras=("left", "right")) == 0
    height, width = cv2.imread(str(tmp_path / "overlay.png")).shape[:2]
    assert height > 0.7 * width  # two cameras, one below the other


def test_the_same_observations_give_the_same_cameras(guide):
    assert main(["--again", str(guide / "pair")]) == 0
    assert reported(guide / "pair" / "again")["cameras"] == reported(guide / "pair")["cameras"]


@pytest.mark.parametrize("job", ["hand", "held"])
def test_a_camera_on_a_robot(guide, job):
    report = reported(guide / job)
    (camera,) = report["cameras"]
    off = np.array(camera["t_cam_base_m"]) - np.linalg.inv(LINK_CAMERA)[:3, 3]
    assert np.all(np.abs(off) < 6.0 * deviations(camera, "tx", "ty", "tz"))
    assert report["target"]["frame"] == "base"
    np.testing.assert_allclose(np.array(report["target"]["transform"])[:3, 3], BASE_TARGET[:3, 3], atol=2e-3)
    assert "frame_id: link" in (guide / job / "extrinsics.yaml").read_text()


def test_a_target_on_a_robot(guide):
    report = reported(guide / "fixed")
    (camera,) = report["cameras"]
    off = np.array(camera["t_cam_base_m"]) - CAMERA_BASE[:3, 3]
    assert np.all(np.abs(off) < 6.0 * deviations(camera, "tx", "ty", "tz"))
    assert report["target"]["frame"] == "link"
    assert "frame_id: base" in (guide / "fixed" / "extrinsics.yaml").read_text()


def test_intrinsics_of_kalibr_are_held(scene, tmp_path, capsys):
    chain = tmp_path / "camchain.yaml"
    chain.write_text(
        "cam0:\n  camera_model: pinhole\n  intrinsics: [300.0, 301.0, 162.0, 117.0]\n  distortion_model: radtan\n"
        "  distortion_coeffs: [-0.2, 0.05, 0.0, 0.0]\n  resolution: [320, 240]\n  rostopic: /left\n"
    )
    (tmp_path / "cam0").symlink_to(scene / "images" / "left")
    robot = ("--robot", scene / "poses.csv", "--eye-in-hand", "--order", "xyzw", "--intrinsics", f"cam0={chain}")
    assert calibrate(tmp_path, tmp_path / "results", *robot, cameras=("cam0",)) == 0
    (camera,) = json.loads((tmp_path / "results" / "report.json").read_text())["cameras"]
    np.testing.assert_allclose(camera["K"], LEFT.K, atol=1e-2)
    chain.write_text(chain.read_text().replace("radtan", "fov"))
    assert calibrate(tmp_path, tmp_path / "results", *robot, cameras=("cam0",)) == 1
    assert "cam0.distortion_model" in capsys.readouterr().err


def test_intrinsics_of_opencv_are_held(scene, tmp_path):
    for lens, coefficients in (("plumb_bob", D[:, None]), ("rational_polynomial", np.array([*D[:4], 0.01, 0, 0, 0]))):
        storage = cv2.FileStorage(str(tmp_path / f"{lens}.yml"), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", 320)
        storage.write("image_height", 240)
        storage.write("camera_matrix", LEFT.K)
        storage.write("distortion_coefficients", coefficients)
        storage.release()
    robot = ("--robot", scene / "poses.csv", "--eye-in-hand", "--order", "xyzw")
    given = ("--intrinsics", f"left={tmp_path / 'plumb_bob.yml'}")
    assert calibrate(scene / "images", tmp_path / "results", *robot, *given) == 0
    (camera,) = json.loads((tmp_path / "results" / "report.json").read_text())["cameras"]
    np.testing.assert_allclose(camera["K"], LEFT.K, atol=1e-2)
    found = _given("left", tmp_path / "rational_polynomial.yml", None)
    assert found.lens == "rational_polynomial"
    np.testing.assert_allclose(found.values[4:], [*D[:4], 0.01, 0, 0, 0])


def test_a_lens_with_a_k3_is_held_as_the_larger_model(tmp_path):
    camera = CameraModel(320, 240, LEFT.K, np.array([-0.2, 0.05, 0.001, 0.0, -0.01]))
    (tmp_path / "left.yaml").write_text(camera_info_yaml("left", camera))
    found = _given("left", tmp_path / "left.yaml", None)
    assert found.lens == "rational_polynomial"
    np.testing.assert_allclose(found.values[4:], [-0.2, 0.05, 0.001, 0.0, -0.01, 0.0, 0.0, 0.0])


def test_intrinsics_of_other_images_are_refused(guide, scene, tmp_path, capsys):
    twice = CameraModel(640, 480, np.diag([2.0, 2.0, 1.0]) @ LEFT.K, D)
    (tmp_path / "left.yaml").write_text(camera_info_yaml("left", twice))
    report = json.loads((guide / "left" / "report.json").read_text())
    report["cameras"][0]["width"], report["cameras"][0]["height"] = 240, 320
    (tmp_path / "report.json").write_text(json.dumps(report))
    for name, size in (("left.yaml", "640 x 480"), ("report.json", "240 x 320")):
        given = ("--intrinsics", f"left={tmp_path / name}")
        assert calibrate(scene / "images", tmp_path / "results", *given) == 1
        assert f"{name}: is of images of {size} px, the images have 320 x 240 px." in capsys.readouterr().err


def test_images_without_a_pose_of_the_robot_are_left_out(scene, tmp_path, capsys):
    lines = (scene / "poses.csv").read_text().splitlines(keepends=True)
    poses, none = tmp_path / "some.csv", tmp_path / "none.csv"
    poses.write_text("".join(line for line in lines if not line.startswith(("view2", "view5"))))
    none.write_text("".join(line.replace("view", "image") for line in lines))
    robot = ("--eye-in-hand", "--order", "xyzw", "--robot")
    assert calibrate(scene / "images", tmp_path / "results", *robot, poses) == 0
    assert f"{poses}: no pose for 2 of 8 images, which are left out: view2, view5" in capsys.readouterr().out
    kept = (tmp_path / "results" / "observations.json").read_text()
    assert [i for i in range(8) if f"view{i}" in kept] == [0, 1, 3, 4, 6, 7]
    assert calibrate(scene / "images", tmp_path / "other", *robot, none) == 1
    assert f"{none}: has no pose for any of the images view0, view1, view2" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "target", "told"),
    [
        ((), "chessboard:9x6:30mm", "As chessboard:8x5:0.03m it is found in 8 of 8: count its inner corners, not its"),
        ((), "charuco:7x5:40mm:30mm:4X4_50", "found in 0 of 8 images: view0.png does not show it"),
        (("--robot", "poses.csv", "--eye-in-hand"), TARGET, "poses.csv:2: tell the order of the quaternions: --order"),
        (("--robot", "poses.csv", "--eye-in-hand", "--order", "wxyz"), TARGET, "With quaternions read as x, y, z, w"),
        (("--robot", "poses.csv", "--eye-to-hand", "--order", "xyzw"), TARGET, "With"),
        (("--intrinsics", "right=poses.csv"), TARGET, "poses.csv"),
    ],
)
def test_what_is_wrong_is_told(scene, tmp_path, capsys, monkeypatch, more, target, told):
    monkeypatch.chdir(scene)
    assert calibrate(scene / "images", tmp_path / "results", *more, target=target) == 1
    assert told in capsys.readouterr().err
    assert not (tmp_path / "results" / "report.json").exists()


def test_images_that_cannot_be_used_are_told(scene, tmp_path, capsys):
    for name in ("a", "b", "c"):
        (tmp_path / name).mkdir()
    assert calibrate(tmp_path, tmp_path / "results", cameras=("a",)) == 1
    assert "has no images" in capsys.readouterr().err
    for i in range(4):
        content = (scene / "images" / "left" / f"view{i}.png").read_bytes()
        (tmp_path / "b" / f"{i}.png").write_bytes(content)
    cv2.imwrite(str(tmp_path / "b" / "4.png"), np.zeros((240, 320), dtype=np.uint8))
    assert calibrate(tmp_path, tmp_path / "results", cameras=("b",)) == 0
    assert "4.png is blank" in capsys.readouterr().out
    cv2.imwrite(str(tmp_path / "b" / "5.png"), np.zeros((480, 640), dtype=np.uint8))
    assert calibrate(tmp_path, tmp_path / "results", cameras=("b",)) == 1
    assert "5.png has 640 x 480 px, 0.png 320 x 240: images of one camera have one size" in capsys.readouterr().err
    (tmp_path / "c" / "0.png").write_bytes(b"no image")
    assert calibrate(tmp_path, tmp_path / "results", cameras=("c",)) == 1
    assert "0.png: is no image of 8 or 16 bits" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [["--target", TARGET], ["--images", "a=b"], ["--images", "a=b", "a=c", "--target", TARGET, "--results", "r"],
     ["--images", "a=b", "--target", TARGET, "--results", "r", "--robot", "p.csv"]],
)  # fmt: skip
def test_wrong_arguments_are_refused(words):
    with pytest.raises(SystemExit) as refused:
        main(words)
    assert refused.value.code == 2
